"""Evidence from captures that were not fitted, against really refitting without them."""

from typing import Any

import numpy as np
import pytest
from diagnosis.small_session import SIGMA_PX, explanation, fitted_at_rest, hypothesis, measured
from numpy.typing import NDArray
from present import present

from wlr_render.bench.bench import Bench
from wlr_render.captures.session import SessionPlan
from wlr_render.diagnosis.fit import Fit
from wlr_render.diagnosis.held_out import HeldOutImprovement, held_out_improvement, held_out_residual
from wlr_render.diagnosis.observations import SEE_THROUGH, Observations
from wlr_render.diagnosis.prediction import Explanation, Predictor
from wlr_render.numerics.arrays import FloatArray


@pytest.fixture(scope="module")
def few(bench: Bench, plan: SessionPlan) -> Observations:
    """Observations with two causes at work, subsampled to twelve readings a capture."""
    observations = measured(
        bench, plan, SIGMA_PX, seed=5, camera_pupil_offset=[0.3, -0.2, 0.4], stage_scale=[1, 0, 0.5]
    )
    return observations.of_rows(observations.spread(430))


def improvement_by(before: FloatArray, after: NDArray[Any]) -> HeldOutImprovement:
    """The improvement by the squares of captures."""
    return held_out_improvement(np.sqrt(before), np.sqrt(after), np.arange(len(before)))


def squares_of(observations: Observations, found: Fit | None) -> FloatArray:
    squares = np.sum(held_out_residual(present(found), observations) ** 2, axis=1)
    return np.asarray(np.bincount(observations.group, squares), dtype=np.float64)


@pytest.mark.slow
@pytest.mark.parametrize(
    "start",
    [
        explanation(camera_pupil_offset=[0, 0, 0]),
        explanation(camera_pupil_offset=[0, 0, 0], stage_scale=[0, 0, 0]),
        explanation(combiner_tilt=[0, 0, 0]),  # a wrong one, which does not reach the noise
    ],
    ids=lambda start: "+".join(start.names),
)
def test_held_out_squares_are_those_of_refits_without_the_capture(few: Observations, start: Explanation) -> None:
    found = fitted_at_rest(few, start)
    fast, predictor = squares_of(few, found), Predictor(few)
    for number in range(0, len(few.captures), 4):
        mine = few.group == number
        assert found is not None
        refit = fitted_at_rest(few.of_rows(~mine), found.explanation)
        slow = np.sum(predictor.residual(present(refit).explanation)[mine] ** 2)
        assert fast[number] == pytest.approx(slow, rel=0.01)
        assert fast[number] > np.sum(found.at.residual[mine] ** 2)


def test_what_one_capture_alone_determines_is_unknown_without_it(bench: Bench, plan: SessionPlan) -> None:
    """A single display capture and all of the targets: without it the panel stands where its prior has it."""
    one = measured(bench, plan, SIGMA_PX, seed=5, panel_shift=[0.2, -0.1])
    one = one.of_rows((one.part == SEE_THROUGH) | (one.group == 0))
    found, nothing = fitted_at_rest(one, explanation(panel_shift=[0, 0])), fitted_at_rest(one, Explanation())
    assert squares_of(one, found)[0] == pytest.approx(squares_of(one, nothing)[0], rel=0.01)
    assert squares_of(one, nothing)[0] > 1e4


def test_without_parameters_nothing_changes_by_holding_out(few: Observations) -> None:
    found = fitted_at_rest(few, Explanation())
    assert found is not None
    np.testing.assert_array_equal(held_out_residual(found, few), found.at.residual)


def test_a_true_cause_gains_and_a_false_one_does_not(few: Observations) -> None:
    half = fitted_at_rest(few, explanation(camera_pupil_offset=[0, 0, 0]))
    whole = fitted_at_rest(few, explanation(camera_pupil_offset=[0, 0, 0], stage_scale=[0, 0, 0]))
    gain = improvement_by(squares_of(few, half), squares_of(few, whole))
    assert gain.percent > 0
    assert gain.significance > 3
    idle = fitted_at_rest(few, present(whole).explanation.plus(hypothesis("lateral_colour")))
    worse = improvement_by(squares_of(few, whole), squares_of(few, idle))
    assert worse.significance < 2


def test_the_gain_is_that_of_the_rms_and_vanishes_for_none() -> None:
    rng = np.random.default_rng(6)
    before = rng.uniform(50, 100, 40)
    half = improvement_by(before, 0.25 * before)
    assert half.percent == pytest.approx(50.0)
    assert half.sigma == pytest.approx(0.0, abs=1e-9)
    same = improvement_by(before, before)
    assert (same.percent, same.significance) == (0.0, 0.0)
    worse = improvement_by(before, 4.0 * before)
    assert worse.percent == pytest.approx(-100.0)
    assert worse.significance < -3


def test_the_sigma_of_a_gain_is_its_spread_over_sessions() -> None:
    """Sessions of 30 captures whose squares before and after are drawn by the same law: how the gain scatters."""
    rng = np.random.default_rng(7)
    before = rng.chisquare(20, (400, 30)) * rng.uniform(0.5, 2.0, (400, 30))
    after = 0.8 * before * rng.uniform(0.5, 1.5, before.shape)
    gains = [improvement_by(b, a) for b, a in zip(before, after, strict=True)]
    stated = np.mean([gain.sigma for gain in gains])
    assert stated == pytest.approx(np.std([gain.percent for gain in gains]), rel=0.1)


def test_the_significance_is_the_mean_difference_over_its_standard_error() -> None:
    """By hand: differences 1, 2, 3, 4 have mean 2.5, standard deviation sqrt(5/3), standard error sqrt(5/12)."""
    before = np.array([11.0, 12.0, 13.0, 14.0])
    assert improvement_by(before, np.full(4, 10.0)).significance == pytest.approx(2.5 / np.sqrt(5 / 12))


def test_without_a_gain_the_significance_scatters_by_one() -> None:
    rng = np.random.default_rng(8)
    draws = [improvement_by(*rng.chisquare(100, (2, 50))).significance for _ in range(400)]
    assert np.mean(draws) == pytest.approx(0.0, abs=0.15)
    assert np.std(draws) == pytest.approx(1.0, abs=0.12)
