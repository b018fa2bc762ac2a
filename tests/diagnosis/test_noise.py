"""How much of a session is noise, whatever else is in it; and single readings that are outliers."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from diagnosis.small_session import SIGMA_PX, measured
from numpy.typing import NDArray
from oracle.nature import BenchNature
from present import present

from wlr_render.bench.bench import Bench
from wlr_render.captures.session import SessionPlan
from wlr_render.diagnosis.noise import NoiseFloor, is_significant, noise_of
from wlr_render.diagnosis.observations import DISPLAY, SEE_THROUGH, Observations
from wlr_render.diagnosis.prediction import Explanation, Predictor
from wlr_render.numerics.arrays import FloatArray

EFFECTS = [
    {},
    {"combiner_tilt": [1.0, -1.0, 1.0], "target_bow": [1.0, 1.0]},
    {"thermal_drift": [0.05, 0.05, 600.0]},
]


def nominal_residual(observations: Observations) -> FloatArray:
    return Predictor(observations).residual(Explanation())


def floors_of(observations: Observations) -> tuple[NoiseFloor, ...]:
    return noise_of(observations, nominal_residual(observations)).floors


@pytest.mark.parametrize("effect", EFFECTS, ids=lambda effect: "+".join(effect) or "nothing")
@pytest.mark.parametrize("sigma_px", [0.05, 0.2])
def test_noise_that_is_not_as_stated_is_found_beside_any_effect(
    bench: Bench, plan: SessionPlan, sigma_px: float, effect: Mapping[str, list[float]]
) -> None:
    display, see_through = floors_of(measured(bench, plan, sigma_px, seed=1, **effect))
    for floor in (display, see_through):
        assert floor.stated_px == pytest.approx(SIGMA_PX)
        assert floor.within_px == pytest.approx(sigma_px, rel=0.06)
        assert not floor.is_believable
        assert floor.used_px == pytest.approx(floor.measured_px, rel=0.08)
    assert display.repeats_px == pytest.approx(sigma_px, rel=0.15)  # of two photographs only
    assert np.isnan(see_through.repeats_px)
    assert (display.part, see_through.part) == ("display", "see-through")


@pytest.mark.parametrize("sigma_px", [0.05, 0.2])
def test_a_step_in_time_raises_the_noise_little(bench: Bench, plan: SessionPlan, sigma_px: float) -> None:
    """What it leaves in each photograph is like noise that neighbours share, until its cause is known."""
    slip = [0.5, 0.0, 0.3, 0.2, 0.0, 0.0, 900.0]  # between a place and its repetition
    for floor in floors_of(measured(bench, plan, sigma_px, seed=1, headset_slip=slip)):
        assert 0.94 * sigma_px < floor.within_px < 1.3 * sigma_px
        assert not floor.is_believable


def test_noise_as_stated_is_believed(bench: Bench, plan: SessionPlan) -> None:
    for floor in floors_of(measured(bench, plan, SIGMA_PX, seed=2)):
        assert floor.is_believable
        assert floor.used_px == pytest.approx(SIGMA_PX, rel=0.05)


def drawn(clean: Observations, sigma_px: float, seed: int) -> FloatArray:
    """A residual of white noise, in units of the stated sigma."""
    return sigma_px / SIGMA_PX * np.random.default_rng(seed).normal(size=(len(clean), 2))


@pytest.mark.parametrize("larger", [1.0, 1.2])
@pytest.mark.slow
def test_noise_a_little_larger_than_stated_is_found_and_not_called_unbelievable(
    clean: Observations, larger: float
) -> None:
    """Over draws: the noise used is the true one; it is disbelieved only where it matters."""
    found = [floor for seed in range(20) for floor in noise_of(clean, drawn(clean, larger * SIGMA_PX, seed)).floors]
    off = np.array([floor.measured_px - larger * SIGMA_PX for floor in found])
    assert abs(np.mean(off)) < 0.02 * SIGMA_PX
    # Errors also cover what the photographs do not exclude: that neighbours share some of the noise.
    assert 0.4 < np.sqrt(np.mean((off / [floor.error_px for floor in found]) ** 2)) < 1.2
    nearer = np.abs([floor.used_px - larger * SIGMA_PX for floor in found]) < np.abs(off)
    assert np.mean(nearer) > 0.9 or larger > 1.0
    believed = np.mean([floor.is_believable for floor in found])
    assert believed > 0.95 or larger > 1.0
    # Of white noise each floor has a rim, factors and a share in 1 of 20 draws at most.
    for wrong in (lambda f: f.rim_factor != 1.0, lambda f: f.shared != 0.0, lambda f: f.photographs_differ > 0.15):
        assert sum(map(wrong, found)) <= len(found) // 20


def test_a_stated_sigma_weighs_as_one_that_is_known_to_a_tenth(bench: Bench, plan: SessionPlan) -> None:
    """Few points tell little of the noise: then the stated one draws it, by the share of what is known."""
    few = measured(bench, SessionPlan(display=plan.display)).of_rows(present(plan.display).capture < 2)
    floor = noise_of(few, drawn(few, 1.15 * SIGMA_PX, 1)).floors[0]
    assert floor.is_believable
    relative = floor.error_px / floor.measured_px
    weight = 0.1**2 / (0.1**2 + relative**2)
    assert 0.3 < weight < 0.9
    logs = np.log([floor.stated_px, floor.measured_px])
    assert np.log(floor.used_px) == pytest.approx((1 - weight) * logs[0] + weight * logs[1])


def natural(clean: Observations, seed: int, **imperfections: Any) -> NDArray[Any]:
    """A residual of the noise of an imperfect bench, by code that shares nothing with the diagnosis."""
    rng = np.random.default_rng(seed)
    white = rng.normal(size=(len(clean), 2))
    # Distance of neighbouring points of the display; that of dots is near.
    noise = BenchNature(**imperfections).noise(white, clean.image_place, clean.group, clean.photograph, 90.0, rng)
    return np.asarray(noise)


@pytest.mark.slow
def test_white_noise_with_tails_has_no_rim_no_factors_and_shares_nothing(clean: Observations) -> None:
    """The tails of Student's t are in no part of the model; without them, see above."""
    found = [floor for seed in range(12) for floor in noise_of(clean, natural(clean, seed, t_dof=4.0)).floors]
    assert sum(floor.rim_factor != 1.0 for floor in found) <= 4
    assert sum(floor.shared != 0.0 for floor in found) <= 4
    assert sum(floor.photographs_differ > 0.15 for floor in found) <= 4


def test_photographs_that_are_noisier_are_found_with_their_factor(clean: Observations) -> None:
    rng = np.random.default_rng(4)
    larger = np.where(rng.permutation(len(clean.captures)) < 11, 3.0, 1.0)
    noise = noise_of(clean, drawn(clean, SIGMA_PX, 4) * larger[clean.group][:, None])
    assert all(floor.photographs_differ > 0.3 for floor in noise.floors)
    sigma = np.array([noise.sigma_px[clean.group == number].mean() for number in range(len(larger))]) / SIGMA_PX
    assert np.mean(sigma / larger) == pytest.approx(1.0, abs=0.1)
    np.testing.assert_allclose(sigma / np.mean(sigma / larger), larger, rtol=0.3)


def test_noise_that_rises_to_the_rim_is_found(clean: Observations) -> None:
    """With tails, which the likelihood does not know of."""
    for seed in range(4):
        noise = noise_of(clean, natural(clean, seed, rim_factor=3.0, t_dof=5.0))
        floor = noise.floor(DISPLAY)
        assert floor.rim_factor == pytest.approx(3.0, rel=0.3)
        radius = np.linalg.norm(clean.image_place - [640, 512], axis=1) / np.hypot(640, 512)
        rows = clean.part == DISPLAY
        true = SIGMA_PX * (1.0 + 2.0 * radius**2)
        np.testing.assert_allclose(noise.sigma_px[rows], true[rows], rtol=0.35)
        assert np.std(noise.sigma_px[rows] / true[rows]) < 0.06
        # Of tails the median photograph has fewer than all have together.
        assert np.mean(noise.sigma_px[rows] / true[rows]) == pytest.approx(1.0, abs=0.15)


def test_noise_that_neighbours_share_is_found_and_is_noise(clean: Observations) -> None:
    """The oracle's field has another correlation than the model's; surfaces follow most of it, and must not gain."""
    for seed in range(4):
        floor = noise_of(clean, natural(clean, seed, shared=0.5, shared_spacings=1.5)).floor(DISPLAY)
        assert floor.shared == pytest.approx(0.5, abs=0.3)
        assert floor.shared_reach_px > 0.0
        assert floor.used_px == pytest.approx(SIGMA_PX, rel=0.3)
        assert floor.within_px > 0.8 * SIGMA_PX


@pytest.mark.parametrize(("spacings", "parts", "most"), [(1.2, 2, 1.5), (2.0, 1, 2.0)])
@pytest.mark.slow
def test_errors_cover_noise_that_neighbours_share(
    clean: Observations, spacings: float, parts: int, most: float
) -> None:
    """Surfaces follow it; 49 dots do not show noise that they share over two of their distances."""
    draws = (natural(clean, seed, shared=0.3, shared_spacings=spacings) for seed in range(16))
    found = [floor for draw in draws for floor in noise_of(clean, draw).floors[:parts]]
    off = np.array([(floor.measured_px - SIGMA_PX) / floor.error_px for floor in found])
    assert 0.5 < np.sqrt(np.mean(off**2)) < most


def test_a_difference_must_be_both_sure_and_large() -> None:
    assert is_significant(0.2, 0.05)
    assert is_significant(-0.2, 0.05)
    assert not is_significant(0.2, 0.1)
    assert not is_significant(0.05, 0.001)


@pytest.mark.slow
def test_few_repeats_do_not_override_the_scatter_within_photographs(bench: Bench, plan: SessionPlan) -> None:
    """Over draws: the combined noise is nearer the truth than either, and stated noise that is true is believed."""
    exact = measured(bench, SessionPlan(display=plan.display))
    found = [noise_of(exact, drawn(exact, SIGMA_PX, seed)).floors[0] for seed in range(60)]
    repeats, within, both = (
        np.std([getattr(floor, name) for floor in found]) for name in ("repeats_px", "within_px", "measured_px")
    )
    assert both < within < repeats
    assert both == pytest.approx(np.mean([floor.error_px for floor in found]), rel=0.35)
    assert np.mean([floor.is_believable for floor in found]) > 0.95


def test_a_pattern_finer_than_the_points_is_no_noise_where_repeats_tell(bench: Bench, plan: SessionPlan) -> None:
    exact = measured(bench, SessionPlan(display=plan.display))
    residual = drawn(exact, SIGMA_PX, 5)
    # The same in each photograph of one place, and rough within it.
    pattern = np.random.default_rng(6).normal(0, 2, (len(exact) // 18, 2))
    floor = noise_of(exact, residual + np.tile(pattern, (18, 1))).floors[0]
    assert floor.within_px > 2 * SIGMA_PX
    assert floor.measured_px == floor.repeats_px == pytest.approx(SIGMA_PX, rel=0.2)


def test_the_noise_between_repeats_is_scaled_by_how_often(bench: Bench, plan: SessionPlan) -> None:
    """Averaged over draws: a deviation from the mean of two readings is smaller than the noise."""
    exact = measured(bench, SessionPlan(display=plan.display))
    found = [floors_of(measured(bench, SessionPlan(display=plan.display), 0.1, seed))[0] for seed in range(8)]
    assert np.mean([floor.repeats_px for floor in found]) == pytest.approx(0.1, rel=0.06)
    assert np.mean([floor.within_px for floor in found]) == pytest.approx(0.1, rel=0.02)
    assert floors_of(exact)[0].repeats_px < 1e-6


def test_too_few_points_in_a_photograph_give_no_noise_estimate(bench: Bench, plan: SessionPlan) -> None:
    few = measured(bench, plan, SIGMA_PX)
    few = few.of_rows(few.spread(200))
    for floor in floors_of(few):
        assert np.isnan(floor.within_px)
        assert floor.used_px == pytest.approx(SIGMA_PX)
    assert not noise_of(few, nominal_residual(few)).outlier.any()


class TestOutlierReadings:
    def test_exactly_those_injected_are_found_beside_any_effect(self, bench: Bench, plan: SessionPlan) -> None:
        """At the corner, at the edge, in the middle of a photograph, in repeats, and two in one photograph."""
        observations = measured(bench, plan, SIGMA_PX, seed=3, combiner_tilt=[1.0, 1.0, 1.0])
        display, dots = np.array([0, 5, 100, 540, 901, 930]), np.array([7, 300, 600])
        read = observations.session.readings
        present(read.panel_pixel)[display] += [12.0, -5.0]
        present(read.dot_pixel)[dots] += [3.0, -2.0]
        found = np.flatnonzero(noise_of(observations, nominal_residual(observations)).outlier)
        first_dot = np.count_nonzero(observations.part == DISPLAY)
        np.testing.assert_array_equal(found, np.concatenate([display, first_dot + dots]))
        floors = floors_of(observations)
        assert all(floor.measured_px == pytest.approx(SIGMA_PX, rel=0.15) for floor in floors)

    @pytest.mark.parametrize("effect", EFFECTS, ids=lambda effect: "+".join(effect) or "nothing")
    def test_none_are_found_where_there_are_none(
        self, bench: Bench, plan: SessionPlan, effect: Mapping[str, list[float]]
    ) -> None:
        observations = measured(bench, plan, SIGMA_PX, seed=4, **effect)
        assert not noise_of(observations, nominal_residual(observations)).outlier.any()

    def test_more_noise_than_stated_is_no_outlier_reading(self, bench: Bench, plan: SessionPlan) -> None:
        observations = measured(bench, plan, 5 * SIGMA_PX, seed=5)
        assert noise_of(observations, nominal_residual(observations)).outlier.sum() <= 2

    def test_a_capture_that_moved_is_no_outlier_reading(self, bench: Bench, plan: SessionPlan) -> None:
        observations = measured(bench, plan, SIGMA_PX, seed=6)
        present(observations.session.readings.dot_pixel)[
            observations.group[observations.part == SEE_THROUGH] == 20
        ] += 20.0
        assert not noise_of(observations, nominal_residual(observations)).outlier.any()
