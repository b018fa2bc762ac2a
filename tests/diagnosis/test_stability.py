"""A true cause has one value wherever it is measured, also beside something unexplained; a spurious match has not."""

import numpy as np
import pytest
from small_session import SIGMA_PX, explanation, fitted_at_rest, measured

from wlr_render.diagnosis.causes import CAUSES
from wlr_render.diagnosis.fit import reduced_chi_squared
from wlr_render.diagnosis.stability import instability

STABLE, UNSTABLE = 0.1, 0.35


def waved(observations, size_px):
    """With waves over the panel that no cause explains."""
    read = observations.session.readings
    read.panel_pixel[:, 0] += size_px * np.sin(2 * np.pi * read.panel_pixel[:, 0] / 500)
    return observations


def of(observations, **causes):
    found = fitted_at_rest(observations, explanation(**causes))
    return instability(observations, found), found


@pytest.fixture(scope="module")
def tilted(bench, plan):
    return measured(bench, plan, SIGMA_PX, seed=4, combiner_tilt=[0.3, -0.2, 0.3])


@pytest.fixture(scope="module")
def tilted_and_waved(bench, plan):
    return waved(measured(bench, plan, SIGMA_PX, seed=4, combiner_tilt=[0.3, -0.2, 0.3]), 2.0)


def test_a_true_cause_is_stable_down_at_the_noise(tilted):
    change, found = of(tilted, combiner_tilt=[0, 0, 0])
    assert reduced_chi_squared(found) < 1.1
    assert change[0] < 0.02


def test_a_true_cause_is_stable_beside_something_unexplained(tilted_and_waved):
    change, found = of(tilted_and_waved, combiner_tilt=[0, 0, 0])
    assert reduced_chi_squared(found) > 10
    assert change[0] < STABLE


@pytest.mark.parametrize("name", ["stage_scale", "camera_distortion", "panel_scale", "panel_rotation"])
def test_a_spurious_match_is_not(tilted_and_waved, name):
    change, _ = of(tilted_and_waved, **{name: CAUSES[name].null()})
    assert change[0] > 2 * UNSTABLE


def test_of_two_causes_the_spurious_match_is_recognised(tilted_and_waved):
    change, _ = of(tilted_and_waved, combiner_tilt=[0, 0, 0], stage_scale=[0, 0, 0])
    assert change[0] < STABLE
    assert change[1] > 2 * UNSTABLE


@pytest.mark.parametrize("seed", range(4))
def test_a_small_true_cause_is_not_blamed_for_what_noise_changes(bench, plan, seed):
    """At five standard errors the halves differ by much of the value, as they must."""
    observations = measured(bench, plan, SIGMA_PX, seed=seed, stage_backlash=[0.0052])
    change, found = of(observations, stage_backlash=[0.0])
    assert abs(found.explanation.vector()[0]) < 9 * found.sigmas()[0]
    assert change[0] < UNSTABLE


def test_a_session_without_photographs_has_no_halves(bench, run_time):
    change, _ = of(measured(bench, run_time, SIGMA_PX, latency=[5.0]), latency=[0.0])
    np.testing.assert_array_equal(change, [0.0])
