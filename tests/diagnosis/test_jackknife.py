"""Jackknife errors: those of refits, and true where captures are displaced, which the model does not know."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from diagnosis.small_session import SIGMA_PX, explanation, fitted_at_rest, measured, with_noise
from present import present

from wlr_render.bench.bench import Bench
from wlr_render.bench.simulate_session import simulate
from wlr_render.captures.session import SessionPlan
from wlr_render.diagnosis.fit import Fit
from wlr_render.diagnosis.held_out import jackknife, left_out_changes
from wlr_render.diagnosis.observations import Observations
from wlr_render.diagnosis.prediction import Predictor
from wlr_render.numerics.arrays import BoolArray, FloatArray

REPEATABILITY_M = 30e-6
DRAWS = 12


def at_rest(observations: Observations, rows: BoolArray, values: Mapping[Any, Any]) -> Fit | None:
    return fitted_at_rest(observations.of_rows(rows), explanation(**values))


def test_changes_are_those_of_fits_without_the_capture(bench: Bench, plan: SessionPlan) -> None:
    clean = measured(bench, plan, target_scale=[0.3, 0.2], panel_shift=[0.1, -0.1])
    observations = with_noise(clean, SIGMA_PX, np.random.default_rng(1))
    start = {"target_scale": [0.3, 0.2], "panel_shift": [0.1, -0.1]}
    group = observations.group
    found = at_rest(observations, group >= 0, start)
    assert found is not None
    changes = left_out_changes(found, observations)
    assert changes.shape == (36, 4)
    for number in (2, 20):
        without = at_rest(observations, group != number, start)
        change = present(without).explanation.vector() - found.explanation.vector()
        prior_sigma = [parameter.prior_sigma for parameter in found.explanation.parameters()]
        np.testing.assert_allclose(changes[number] * prior_sigma, change, atol=0.02 * found.sigmas().max())
    kept = at_rest(observations, group != 0, start)
    others = observations.of_rows(group != 0)
    assert kept is not None
    assert np.isnan(left_out_changes(kept, others)[0]).all()
    assert np.isfinite(jackknife(kept, others)).all()


@pytest.mark.slow
def test_errors_cover_where_the_stage_repeats_badly_and_those_of_a_fit_at_rest_do_not(
    bench: Bench, plan: SessionPlan
) -> None:
    """Each capture stands some hundredths of a millimetre off, and its readings share that error; the truth is 0."""
    draws = [_with_a_bad_stage(bench, plan, np.random.default_rng(seed)) for seed in range(DRAWS)]
    values, by_fit, by_captures = (np.array(each) for each in zip(*draws, strict=True))
    assert np.sqrt(np.mean((values / by_fit) ** 2)) > 2.0
    assert 0.6 < np.sqrt(np.mean((values / by_captures) ** 2)) < 1.6


def _with_a_bad_stage(bench: Bench, plan: SessionPlan, rng: np.random.Generator) -> tuple[Any, Any, FloatArray]:
    """Fitted values, their errors by the fit, and their jackknife errors."""
    assert plan.display is not None
    shifts = rng.normal(0, REPEATABILITY_M, (len(np.unique(plan.display.capture)), 3))
    there = replace(plan.display, stage=plan.display.stage + shifts[plan.display.capture])
    read = measured(bench, SessionPlan(there), SIGMA_PX, seed=int(rng.integers(1 << 30))).session
    nominal = replace(read, plan=SessionPlan(plan.display))
    observations = Predictor.of_session(bench, nominal).observations
    assert np.isfinite(present(simulate(bench, nominal.plan).panel_pixel)).all()
    found = fitted_at_rest(observations, explanation(stage_scale=[0.0, 0.0, 0.0]))
    assert found is not None
    return found.explanation.vector(), found.sigmas(), jackknife(found, observations)


def test_one_capture_gives_no_error(bench: Bench, plan: SessionPlan) -> None:
    observations = measured(bench, plan, SIGMA_PX, target_scale=[0.3, 0.2])
    one = observations.group == 20
    found = at_rest(observations, one, {"target_scale": [0.3, 0.2]})
    assert np.isnan(jackknife(present(found), observations.of_rows(one))).all()
