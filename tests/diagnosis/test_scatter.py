"""How captures scatter: against dense Gaussian algebra, and on motions with tails, which the model does not know."""

from dataclasses import replace

import numpy as np
import pytest
from diagnosis.small_session import measured, scatter_of, weighed

from wlr_render.bench.bench import Bench
from wlr_render.captures.session import SessionPlan
from wlr_render.diagnosis.observations import DISPLAY
from wlr_render.diagnosis.weighed_readings import WeighedReadings
from wlr_render.numerics.arrays import FloatArray, IntArray
from wlr_render.numerics.scatter import (
    Scatter,
    ScatterSums,
    cost,
    cost_and_slopes,
    costs_of_sizes,
    marginal,
    surprise,
)
from wlr_render.numerics.scatter_search import (
    best_scatter,
    motions_of,
    scatter_errors,
    with_moved_captures,
)

Drawn = tuple[ScatterSums, Scatter, FloatArray, FloatArray, FloatArray]


@pytest.fixture(scope="module")
def drawn() -> Drawn:
    """Readings of five captures in two parts, one of which moved, and what follows from them by dense matrices."""
    rng = np.random.default_rng(1)
    group = rng.permutation(np.repeat(np.arange(5), 9))
    part = np.where(group < 3, 0, 1)
    y, motions, columns = (rng.normal(size=(45, 2, *more)) for more in ((), (6,), (3,)))
    motions = 0.01 * motions
    scatter = Scatter(
        np.array([1.3, 1.6, 1.0]), np.array([20.0, 5.0, 8.0]), np.array([60.0, 8.0, 25.0]), np.arange(5) == 1
    )
    sums = ScatterSums.over(y, motions, columns, group, part, 5)
    noise = scatter.noise[part].repeat(2)
    variance = np.diag(noise**2)
    for number in range(5):
        at = 0 if number < 3 else 1
        size = np.repeat([scatter.shift_um[at], scatter.turn_urad[at]], 3)
        if number == 1:
            size = np.hypot(size, [1000.0] * 3 + [8000.0] * 3)
        effect = np.where((group == number).repeat(2)[:, None], motions.reshape(90, 6), 0.0) * size
        variance += effect @ effect.T
    return sums, scatter, y.ravel(), columns.reshape(90, 3), variance


def density(y: FloatArray, variance: FloatArray) -> float:
    return float(y @ np.linalg.solve(variance, y) + np.linalg.slogdet(variance)[1])


def test_motions_are_integrated_out_exactly(drawn: Drawn) -> None:
    sums, scatter, y, columns, variance = drawn
    found = marginal(sums, scatter)
    assert found.minus_two_log == pytest.approx(density(y, variance), rel=1e-9)
    np.testing.assert_allclose(found.information, columns.T @ np.linalg.solve(variance, columns), rtol=1e-8, atol=1e-9)
    np.testing.assert_allclose(found.gradient, columns.T @ np.linalg.solve(variance, y), rtol=1e-8, atol=1e-9)


def test_values_are_integrated_out_over_their_priors_exactly(drawn: Drawn) -> None:
    sums, scatter, y, columns, variance = drawn
    mean, sigma = np.array([0.4, -1.0, 0.2]), np.array([0.3, 1.0, 2.0])
    expected = density(y - columns @ mean, variance + (columns * sigma**2) @ columns.T)
    found = marginal(replace(sums, mean=mean, sigma=sigma), scatter)
    assert found.minus_two_log_evidence == pytest.approx(expected, rel=1e-9)
    some = marginal(sums.of_columns(np.array([2, 0])), scatter)
    expected = density(y, variance + columns[:, [2, 0]] @ columns[:, [2, 0]].T)
    assert some.minus_two_log_evidence == pytest.approx(expected, rel=1e-9)


def test_the_most_probable_motions_are_those_of_linear_regression(drawn: Drawn) -> None:
    sums, scatter, *_ = drawn
    size = np.repeat([20.0, 60.0], 3) / 1.3  # over the noise of the part
    expected = np.linalg.solve(sums.ee[0] + np.diag(size**-2.0), sums.ey[0])
    np.testing.assert_allclose(motions_of(sums, scatter)[0], expected, rtol=1e-8)


def test_carried_effects_are_one_more_random_error_of_all_readings(drawn: Drawn) -> None:
    sums, scatter, y, columns, variance = drawn
    size = np.array([0.3, 2.0])
    carried = replace(sums, mean=np.array([0.4, 0.0, 0.0]), sigma=np.r_[1.0, size], carried=2)
    found = marginal(carried, scatter)
    variance = variance + (columns[:, 1:] * size**2) @ columns[:, 1:].T
    solved = np.linalg.solve(variance, columns[:, :1])
    assert found.minus_two_log == pytest.approx(density(y, variance), rel=1e-9)
    np.testing.assert_allclose(found.information, columns[:, :1].T @ solved, rtol=1e-8)
    np.testing.assert_allclose(found.gradient, solved.T @ y, rtol=1e-8)
    evidence = found.minus_two_log_evidence + surprise(scatter, sums)
    assert cost(carried, scatter) == pytest.approx(evidence, rel=1e-9)


def test_slopes_of_the_evidence_are_its_derivatives(drawn: Drawn) -> None:
    sums, scatter, *_ = drawn
    step, priors = 1e-5, {"mean": np.array([0.4, -0.1, 0.0]), "sigma": np.array([1.0, 1.0, 2.0])}
    sums = replace(sums, **priors, carried=1)
    value, slopes = cost_and_slopes(sums, scatter)
    assert value == pytest.approx(cost(sums, scatter), rel=1e-12)
    for number in (0, 1, 3, 4, 6, 7):
        ahead, back = (scatter.vector() + sign * step * np.eye(9)[number] for sign in (1, -1))
        difference = cost(sums, scatter.at(ahead)) - cost(sums, scatter.at(back))
        assert slopes.ravel()[number] == pytest.approx(difference / (2 * step), rel=1e-5, abs=1e-5)


def test_the_best_sizes_have_the_highest_evidence(drawn: Drawn) -> None:
    sums, scatter, *_ = drawn
    best, cost = best_scatter(sums, scatter)
    assert cost == pytest.approx(marginal(sums, best).minus_two_log_evidence + surprise(best, sums))
    for number in range(8):
        for step in (-0.3, 0.3):
            vector = best.vector()
            vector[number] += step
            other = best.at(vector)
            if np.all(other.noise >= 1.0):
                at = marginal(sums, other).minus_two_log_evidence + surprise(other, sums)
                assert at > cost - 0.05
    np.testing.assert_array_equal(best.moved, scatter.moved)


def test_usual_sizes_are_no_surprise_and_a_moved_capture_costs_its_odds(drawn: Drawn) -> None:
    sums, scatter, *_ = drawn
    usual = replace(Scatter.usual(5), shift_um=np.full(3, 8.0), turn_urad=np.full(3, 25.0))
    assert surprise(usual, sums) == 0.0
    assert surprise(replace(usual, moved=np.arange(5) < 2), sums) == pytest.approx(4.0 * np.log(97.0 / 3.0))
    tenfold = replace(usual, shift_um=np.array([80.0, 8.0, 8.0]))
    assert surprise(tenfold, sums) == pytest.approx((np.log(10.0) / 1.2) ** 2)
    assert not scatter.with_other(1).moved.any()


@pytest.fixture(scope="module")
def still(bench: Bench, plan: SessionPlan) -> WeighedReadings:
    """Readings without a residual, to which motions and noise are added."""
    return weighed(measured(bench, plan))


def sums_of(
    readings: WeighedReadings,
    rng: np.random.Generator,
    shift_um: float,
    turn_urad: float,
    moved: tuple[int, ...] | IntArray = (),
    noise_dof: float = 5.0,
    motion_dof: float = 4.0,
) -> ScatterSums:
    """Readings with noise and motions of Student's t, where the model has normal ones."""
    observed = readings.observations
    count = len(observed.captures)
    noise = rng.standard_t(noise_dof, (len(observed), 2)) * np.sqrt((noise_dof - 2.0) / noise_dof)
    sizes = np.repeat([shift_um, turn_urad], 3)
    motion = rng.normal(size=(count, 6)) * sizes
    if np.isfinite(motion_dof):
        motion *= np.sqrt((motion_dof - 2.0) / rng.chisquare(motion_dof, (count, 1)))
    for number in moved:
        motion[number] = rng.choice([-1.0, 1.0], 6) * rng.uniform(
            [300.0] * 3 + [1000.0] * 3, [900.0] * 3 + [4000.0] * 3
        )
    y = noise + np.einsum("naj,nj->na", readings.motions, motion[observed.group])
    return ScatterSums.over(y, readings.motions, np.zeros((*y.shape, 0)), observed.group, observed.part, count)


@pytest.mark.parametrize(("shift_um", "turn_urad"), [(10.0, 20.0), (30.0, 60.0)])
def test_sizes_of_motions_come_back_within_their_errors(
    still: WeighedReadings, shift_um: float, turn_urad: float
) -> None:
    """Over sessions, with noise that has tails: the display tells both sizes, each with the error that is stated."""
    off, logs = [], []
    for seed in range(15):
        sums = sums_of(still, np.random.default_rng(seed), shift_um, turn_urad, motion_dof=np.inf)
        found, _ = best_scatter(sums, Scatter.usual(36))
        errors = scatter_errors(sums, found)
        logs.append([np.log(found.shift_um[0] / shift_um), np.log(found.turn_urad[0] / turn_urad)])
        off.append(np.array(logs[-1]) / errors[1:, 0])
        assert found.noise[0] == pytest.approx(1.0, abs=0.08)
    inside = np.mean(np.abs(off) < 1.0)
    assert abs(inside - 0.683) < 3.0 * np.sqrt(0.683 * 0.317 / np.size(off))
    assert np.sqrt(np.mean(np.square(off))) < 1.4
    np.testing.assert_allclose(np.mean(logs, axis=0), 0.0, atol=0.15)


@pytest.mark.parametrize("count", [1, 3, 6])
def test_captures_that_moved_are_named_exactly(still: WeighedReadings, count: int) -> None:
    for seed in range(4):
        rng = np.random.default_rng(100 + seed)
        moved = np.sort(rng.permutation(18)[:count])
        sums = sums_of(still, rng, 12.0, 30.0, moved)
        found, cost = with_moved_captures(sums, Scatter.usual(36))
        np.testing.assert_array_equal(np.flatnonzero(found.moved), moved)
        assert cost < best_scatter(sums, Scatter.usual(36))[1] - 10.0


def test_where_none_moved_none_is_named(still: WeighedReadings) -> None:
    """Motions have tails, which now and then look like a capture that moved."""
    named = 0
    for seed in range(12):
        sums = sums_of(still, np.random.default_rng(200 + seed), 15.0, 40.0)
        named += int(with_moved_captures(sums, Scatter.usual(36))[0].moved.sum())
    assert named <= 2


def test_captures_that_were_taken_to_have_moved_are_taken_back(still: WeighedReadings) -> None:
    sums = sums_of(still, np.random.default_rng(7), 12.0, 30.0, (4,))
    start = scatter_of(still.observations, 8.0, 25.0, moved=(2, 3, 5, 9))
    found, _ = with_moved_captures(sums, start)
    assert np.flatnonzero(found.moved).tolist() == [4]


def test_a_shift_that_all_captures_have_is_for_the_causes(still: WeighedReadings) -> None:
    """The columns explain it: then it is no motion."""
    observed, rng = still.observations, np.random.default_rng(8)
    columns = still.motions[:, :, :3] * 500.0
    y = rng.normal(size=(len(observed), 2)) + columns @ np.array([1.0, -1.0, 0.5])
    sums = ScatterSums.over(y, still.motions, columns, observed.group, observed.part, len(observed.captures))
    with_it, _ = best_scatter(sums, Scatter.usual(36))
    without, _ = best_scatter(sums.of_columns(np.zeros(0, dtype=int)), Scatter.usual(36))
    assert with_it.shift_um[DISPLAY] < 6.0
    assert without.shift_um[DISPLAY] > 100.0


@pytest.mark.parametrize("count", [1, 2, 7, 40])
def test_the_evidence_of_every_size_is_that_of_dense_algebra(count: int) -> None:
    rng = np.random.default_rng(count)
    half = rng.normal(size=(count // 2 + 1, count))
    information, sizes = half.T @ half, np.array([0.03, 1.0, 40.0])
    gradient = information @ rng.normal(size=count)
    normals = np.eye(count) / sizes[:, None, None] ** 2 + information
    gained = gradient @ np.linalg.solve(normals, np.tile(gradient[:, None], (3, 1, 1)))[..., 0].T
    expected = np.linalg.slogdet(normals)[1] + 2 * count * np.log(sizes) - gained
    costs = costs_of_sizes(information, gradient, sizes)
    np.testing.assert_allclose(costs, expected, rtol=1e-7)
    np.testing.assert_allclose(costs - costs_of_sizes(information, 2 * gradient, sizes), 3 * gained, rtol=1e-6)
