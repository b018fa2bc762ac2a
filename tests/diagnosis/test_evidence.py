"""What a cause must pay for: Occam's razor, whole steps, and chance."""

import numpy as np
import pytest
from small_session import SIGMA_PX, explanation, fitted, fitted_at_rest, measured

from wlr_render.diagnosis.fit import is_physical, reduced_chi_squared
from wlr_render.diagnosis.prediction import Explanation


def fits(observations, *starts):
    return [fitted(observations, start) for start in starts]


def costs(observations, *starts):
    return [found.minus_two_log_evidence for found in fits(observations, *starts)]


@pytest.fixture(scope="module")
def tilted(bench, plan):
    return measured(bench, plan, SIGMA_PX, seed=7, combiner_tilt=[0.3, -0.2, 0.3])


def test_reduced_chi_squared_is_one_at_the_noise_and_more_above(tilted):
    nothing, tilt = (fitted_at_rest(tilted, start) for start in (Explanation(), explanation(combiner_tilt=[0, 0, 0])))
    assert reduced_chi_squared(nothing) > 100
    assert reduced_chi_squared(tilt) == pytest.approx(1.0, abs=4 * np.sqrt(2 / (2 * len(tilted))))


@pytest.mark.parametrize("richer", [{"panel_rotation": [0, 0, 0]}, {"stage_tilt": [0, 0, 0]}, {"target_bow": [0, 0]}])
def test_a_true_cause_costs_less_than_one_that_nests_it(tilted, richer):
    true, more = fits(tilted, explanation(combiner_tilt=[0, 0, 0]), explanation(combiner_tilt=[0, 0, 0], **richer))
    assert more.chi_squared < true.chi_squared
    assert true.minus_two_log_evidence < more.minus_two_log_evidence - 4


def test_a_true_cause_costs_less_than_its_spurious_matches_and_than_nothing(tilted):
    found = costs(
        tilted,
        explanation(combiner_tilt=[0, 0, 0]),
        explanation(panel_shift=[0, 0]),
        explanation(combiner_shift=[0, 0, 0]),
        Explanation(),
    )
    assert found[0] < min(found[1:]) - 40


def test_without_an_effect_nothing_costs_least(bench, plan):
    clean = measured(bench, plan, SIGMA_PX, seed=8)
    nothing, *others = costs(
        clean,
        Explanation(),
        explanation(panel_shift=[0, 0]),
        explanation(combiner_tilt=[0, 0, 0]),
        explanation(pixel_origin=[0, 0]),
        explanation(stage_backlash=[0]),
    )
    assert nothing < min(others)


@pytest.mark.parametrize("offset", [[0.5, -0.5], [0.5, 0.0], [-1.0, 0.5]])
def test_offsets_of_half_pixels_are_counted_wrong(bench, plan, offset):
    origin, shift = costs(
        measured(bench, plan, SIGMA_PX, seed=9, pixel_origin=offset),
        explanation(pixel_origin=[0, 0]),
        explanation(panel_shift=[0, 0]),
    )
    assert origin < shift - 10


@pytest.mark.parametrize("offset", [[0.37, 0.21], [0.5, 0.25], [0.6, -0.1]])
def test_offsets_of_other_sizes_are_shifts_of_the_panel(bench, plan, offset):
    origin, shift = costs(
        measured(bench, plan, SIGMA_PX, seed=9, pixel_origin=offset),
        explanation(pixel_origin=[0, 0]),
        explanation(panel_shift=[0, 0]),
    )
    assert shift < origin - 10


@pytest.mark.parametrize(("thickness_mm", "physical"), [(2.0, True), (-2.0, False)])
def test_a_negative_thickness_is_not_physical_beyond_its_error(bench, plan, thickness_mm, physical):
    observations = measured(bench, plan, SIGMA_PX, seed=10, see_through_plate=[thickness_mm, 0, 0])
    (found,) = fits(observations, explanation(see_through_plate=[0.5, 0, 0]))
    assert is_physical(found) is physical


def test_a_fit_that_loses_readings_is_none(bench, plan):
    """A combiner a hundred millimetres off shows few of the points, and would have nearly no residual."""
    clean = measured(bench, plan, SIGMA_PX, seed=8)
    assert fitted(clean, explanation(combiner_shift=[60.0, 0.0, 0.0]), iterations=0) is None
    assert fitted(clean, explanation(combiner_shift=[100.0, 0.0, 0.0])) is None
