"""What a cause must pay for: Occam's razor, whole steps, and chance."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
import pytest
from diagnosis.small_session import SIGMA_PX, explanation, fitted, fitted_at_rest, measured
from present import present

from wlr_render.bench.bench import Bench
from wlr_render.captures.session import SessionPlan
from wlr_render.diagnosis.fit import is_physical, reduced_chi_squared, whole_step_cost
from wlr_render.diagnosis.observations import Observations
from wlr_render.diagnosis.prediction import Explanation
from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.scatter import Scatter, ScatterSums, marginal


def fits(observations: Observations, *starts: Explanation) -> list[Any]:
    return [fitted(observations, start) for start in starts]


def costs(observations: Observations, *starts: Explanation) -> list[Any]:
    return [found.minus_two_log_evidence for found in fits(observations, *starts)]


@pytest.fixture(scope="module")
def tilted(bench: Bench, plan: SessionPlan) -> Observations:
    return measured(bench, plan, SIGMA_PX, seed=7, combiner_tilt=[0.3, -0.2, 0.3])


def test_reduced_chi_squared_is_one_at_the_noise_and_more_above(tilted: Observations) -> None:
    nothing, tilt = (fitted_at_rest(tilted, start) for start in (Explanation(), explanation(combiner_tilt=[0, 0, 0])))
    assert reduced_chi_squared(present(nothing)) > 100
    assert reduced_chi_squared(present(tilt)) == pytest.approx(1.0, abs=4 * np.sqrt(2 / (2 * len(tilted))))


@pytest.mark.parametrize("richer", [{"panel_rotation": [0, 0, 0]}, {"stage_tilt": [0, 0, 0]}, {"target_bow": [0, 0]}])
def test_a_true_cause_costs_less_than_one_that_nests_it(tilted: Observations, richer: Mapping[str, list[int]]) -> None:
    true, more = fits(tilted, explanation(combiner_tilt=[0, 0, 0]), explanation(combiner_tilt=[0, 0, 0], **richer))
    assert more.chi_squared < true.chi_squared
    assert true.minus_two_log_evidence < more.minus_two_log_evidence - 4


def test_a_true_cause_costs_less_than_its_spurious_matches_and_than_nothing(tilted: Observations) -> None:
    found = costs(
        tilted,
        explanation(combiner_tilt=[0, 0, 0]),
        explanation(panel_shift=[0, 0]),
        explanation(combiner_shift=[0, 0, 0]),
        Explanation(),
    )
    assert found[0] < min(found[1:]) - 40


def test_without_an_effect_nothing_costs_least(bench: Bench, plan: SessionPlan) -> None:
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


@pytest.mark.parametrize(
    ("offset", "cheaper"),
    [
        ([0.5, -0.5], "origin"),
        ([0.5, 0.0], "origin"),
        ([-1.0, 0.5], "origin"),
        ([0.37, 0.21], "shift"),
        ([0.5, 0.25], "shift"),
        ([0.6, -0.1], "shift"),
    ],
)
def test_offsets_of_half_pixels_are_counted_wrong_and_others_are_shifts_of_the_panel(
    bench: Bench, plan: SessionPlan, offset: Sequence[float], cheaper: str
) -> None:
    origin, shift = costs(
        measured(bench, plan, SIGMA_PX, seed=9, pixel_origin=offset),
        explanation(pixel_origin=[0, 0]),
        explanation(panel_shift=[0, 0]),
    )
    assert (shift - origin if cheaper == "origin" else origin - shift) > 10


@pytest.mark.parametrize(("thickness_mm", "physical"), [(2.0, True), (-2.0, False)])
def test_a_negative_thickness_is_not_physical_beyond_its_error(
    bench: Bench, plan: SessionPlan, thickness_mm: float, physical: bool
) -> None:
    observations = measured(bench, plan, SIGMA_PX, seed=10, see_through_plate=[thickness_mm, 0, 0])
    (found,) = fits(observations, explanation(see_through_plate=[0.5, 0, 0]))
    assert is_physical(found) is physical


def test_a_fit_that_loses_readings_is_none(bench: Bench, plan: SessionPlan) -> None:
    """A combiner a hundred millimetres off shows few of the points, and would have nearly no residual."""
    clean = measured(bench, plan, SIGMA_PX, seed=8)
    assert fitted(clean, explanation(combiner_shift=[60.0, 0.0, 0.0]), iterations=0) is None
    assert fitted(clean, explanation(combiner_shift=[100.0, 0.0, 0.0])) is None


def gauss(y: FloatArray, variance: FloatArray) -> float:
    return float(y @ np.linalg.solve(variance, y) + np.linalg.slogdet(variance)[1])


@pytest.mark.parametrize("sigma", [0.02, 0.3, 2.0])
def test_the_evidence_of_whole_steps_is_the_sum_over_the_multiples(sigma: float) -> None:
    """Of offsets k / 2 with the probability 2^-|k| / 3, however well they are known; another value is any number."""
    start = explanation(pixel_origin=[0.0, 0.0], target_scale=[0.0, 0.0])
    prior_sigma = np.array([parameter.prior_sigma for parameter in start.parameters()])[:3]
    rng = np.random.default_rng(3)
    columns = rng.normal(size=(60, 2, 3)) / (sigma * np.sqrt(120.0)) * prior_sigma
    columns[:, :, 2] = rng.normal(size=(60, 2))
    flat = columns.reshape(120, 3)
    y = flat @ (np.array([0.5, -0.8, 0.7]) / np.r_[prior_sigma[:2], 1.0]) + rng.normal(size=120)
    ones = np.zeros(60, dtype=int)
    sums = ScatterSums.over(y.reshape(60, 2), np.zeros((60, 2, 6)), columns, ones, ones, 1)
    scatter = Scatter.usual(1)
    found = marginal(sums, scatter).minus_two_log_evidence
    found += whole_step_cost(sums, scatter, start, np.array([0, 1, 2]))
    variance = np.eye(120) + flat[:, 2:] @ flat[:, 2:].T
    each = [
        -0.5 * gauss(y - flat[:, :2] @ (0.5 * np.array(k) / prior_sigma[:2]), variance)
        - np.sum(np.abs(k) * np.log(2.0) + np.log(3.0))
        for k in product(range(-12, 13), repeat=2)
    ]
    # Of values that are hardly known, multiples beyond the nearest ones count too.
    assert found == pytest.approx(-2.0 * np.logaddexp.reduce(each), abs=0.01 if sigma < 1.0 else 0.3)


@pytest.mark.parametrize(("readings", "most"), [(1890, 0), (60, 2), (24, 3)])
def test_a_panel_displaced_by_any_amount_is_not_counted_wrong(
    bench: Bench, plan: SessionPlan, readings: int, most: int
) -> None:
    """Also where few readings know the offset so badly that a multiple of half a pixel is near."""
    called = 0
    rng = np.random.default_rng(readings)
    for seed in range(10):
        offset = rng.uniform(-8.0, 8.0, 2)
        observations = measured(bench, SessionPlan(plan.display), SIGMA_PX, seed=seed, pixel_origin=offset)
        observations = observations.of_rows(observations.spread(readings))
        origin, shift = costs(observations, explanation(pixel_origin=[0, 0]), explanation(panel_shift=[0, 0]))
        called += int(shift - origin > 2.0 * np.log(100.0))
    assert called <= most


@pytest.mark.parametrize(("name", "field"), [("latency", "latency_s"), ("rolling_scanout", "scanout_s")])
@pytest.mark.parametrize(("stated_ms", "change_ms", "physical"), [(0.0, -4.0, False), (10.0, -4.0, True)])
def test_a_delay_below_zero_is_not_physical(
    bench: Bench, run_time: SessionPlan, name: str, field: str, stated_ms: float, change_ms: float, physical: bool
) -> None:
    """What counts is the whole delay, of which the bench file may state some."""
    nominal = replace(bench, clock=replace(bench.clock, **{field: 1e-3 * stated_ms}))
    observations = measured(nominal, run_time, SIGMA_PX, seed=10, **{name: [change_ms]})
    found = fitted(observations, explanation(**{name: [0.0]}))
    assert found is not None
    assert found.explanation.vector() == pytest.approx([change_ms], abs=0.5)
    assert is_physical(found) is physical
