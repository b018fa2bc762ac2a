"""Repeatability excuses motions that differ from capture to capture, and no error that all captures have in common."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from diagnosis.small_session import SIGMA_PX, measured, with_jitter, with_noise

from wlr_render.bench.bench import Bench
from wlr_render.bench.bench_effects import BenchEffect
from wlr_render.bench.simulate_session import simulate
from wlr_render.captures.session import Session, SessionPlan
from wlr_render.diagnosis.bench_prediction import PredictedPart, effect_errors, predict_session
from wlr_render.diagnosis.observations import DISPLAY
from wlr_render.diagnosis.prediction import Explanation, Predictor
from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.polynomial import Box, Polynomial, total_degree


def predicted(
    bench: Bench, plan: SessionPlan, shift_um: float = 0.0, turn_urad: float = 0.0, **causes: Any
) -> dict[str, PredictedPart]:
    """Parts by name of a session with a few small errors of the bench, whose stage repeats to some size."""
    observations = measured(bench, plan, SIGMA_PX, seed=3, **causes)
    observations = with_jitter(observations, bench, shift_um, np.random.default_rng(1), turn_urad, dof=5)
    return {part.name: part for part in predict_session(bench, observations.session).parts}


@pytest.mark.parametrize(("shift_um", "turn_urad"), [(0.0, 0.0), (15.0, 30.0), (60.0, 100.0)])
def test_captures_that_scatter_as_stages_do_are_predicted(
    bench: Bench, plan: SessionPlan, shift_um: float, turn_urad: float
) -> None:
    for part in predicted(bench, plan, shift_um, turn_urad).values():
        assert part.is_noise
        assert part.whitened == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("repeatability", [(0.0, 0.0), (15.0, 30.0)])
@pytest.mark.parametrize(
    ("causes", "parts"),
    [
        ({"camera_rotation": [0.01, 0.01, 0.0]}, ("display", "see-through")),
        ({"camera_pupil_offset": [0.1, 0.0, 0.0]}, ("display", "see-through")),
        ({"combiner_tilt": [0.02, 0.0, 0.0]}, ("display",)),
        ({"target_scale": [0.2]}, ("see-through",)),
    ],
    ids="+".join,
)
def test_an_error_that_all_captures_have_in_common_is_no_repeatability(
    bench: Bench,
    plan: SessionPlan,
    repeatability: tuple[float, float],
    causes: Mapping[str, Any],
    parts: tuple[str, ...],
) -> None:
    """Each is smaller than 200 um and 600 urad, so that random motions of each capture would explain it."""
    found = predicted(bench, plan, *repeatability, **causes)
    assert {name for name, part in found.items() if not part.is_noise} == set(parts)
    assert all(found[name].whitened > 1.05 for name in parts)


def warped(covariance: FloatArray | None = None, coefficients: FloatArray | float = 0.0) -> BenchEffect:
    """A panel whose warp is known to half a pixel in each of six terms."""
    orders = total_degree(2, 2)
    function = Polynomial(orders, Box(np.zeros(2), np.full(2, 1500.0)), np.zeros((len(orders), 2)) + coefficients)
    return BenchEffect("panel", "shift", function, covariance=covariance)


@pytest.fixture(scope="module")
def root() -> FloatArray:
    return 0.5 * np.eye(12) + 0.1 * np.random.default_rng(1).normal(size=(12, 12))


def test_errors_of_effects_have_the_covariance_of_their_coefficients(
    bench: Bench, plan: SessionPlan, root: FloatArray
) -> None:
    uncertain = replace(bench, effects=(warped(root @ root.T),))
    predictor = Predictor.of_session(uncertain, Session("s", plan, simulate(uncertain, plan)))
    errors, rng = effect_errors(predictor), np.random.default_rng(2)
    drawn = [
        replace(bench, effects=(warped(None, (root @ each).reshape(6, 2)),)) for each in rng.normal(size=(100, 12))
    ]
    changes = [predictor.residual(Explanation()) - predictor.residual_of_bench(each) for each in drawn]
    display = predictor.observations.part == DISPLAY
    stated, seen = np.sum(errors[display] ** 2, axis=2), np.mean(np.square(changes), axis=0)[display]
    assert np.all(errors[~display] == 0.0)
    np.testing.assert_allclose(np.mean(stated, axis=0), np.mean(seen, axis=0), rtol=0.15)
    assert effect_errors(Predictor.of_session(bench, Session("s", plan, simulate(bench, plan)))).shape[2] == 0


def test_a_bench_whose_effects_are_uncertain_predicts_within_their_errors(
    bench: Bench, plan: SessionPlan, root: FloatArray
) -> None:
    true = replace(bench, effects=(warped(None, (root @ np.random.default_rng(3).normal(size=12)).reshape(6, 2)),))
    observations = Predictor.of_session(bench, Session("s", plan, simulate(true, plan))).observations
    session = with_noise(observations, SIGMA_PX, np.random.default_rng(4)).session
    by_covariance = {}
    for covariance in (root @ root.T, None):
        display, see_through = predict_session(replace(bench, effects=(warped(covariance),)), session).parts
        assert see_through.is_noise
        assert see_through.effects_arcmin == 0.0
        by_covariance[covariance is None] = display
    assert by_covariance[False].is_noise
    assert not by_covariance[True].is_noise
    assert by_covariance[False].whitened == pytest.approx(1.0, abs=0.1)
    assert by_covariance[True].whitened > 1.2
    assert by_covariance[False].effects_arcmin == pytest.approx(by_covariance[False].rms_arcmin, rel=0.6)
