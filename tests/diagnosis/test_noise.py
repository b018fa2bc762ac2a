"""How much of a session is noise, whatever else is in it; and single readings that are outliers."""

import numpy as np
import pytest
from small_session import SIGMA_PX, measured

from wlr_render.captures.session import SessionPlan
from wlr_render.diagnosis.noise import (
    NoiseFloor,
    excess_over_noise,
    is_significant,
    noise_floors,
    outlier_readings,
    sigma_of,
)
from wlr_render.diagnosis.observations import DISPLAY, SEE_THROUGH
from wlr_render.diagnosis.prediction import Explanation, Predictor

EFFECTS = [
    {},
    {"combiner_tilt": [1.0, -1.0, 1.0], "target_bow": [1.0, 1.0]},
    {"headset_slip": [0.5, 0.0, 0.3, 0.2, 0.0, 0.0, 900.0]},  # between a place and its repetition
    {"thermal_drift": [0.05, 0.05, 600.0]},
]


def nominal_residual(observations):
    return Predictor(observations).residual(Explanation())


def floors_of(observations):
    return noise_floors(observations, nominal_residual(observations))


@pytest.mark.parametrize("effect", EFFECTS, ids=lambda effect: "+".join(effect) or "nothing")
@pytest.mark.parametrize("sigma_px", [0.05, 0.2])
def test_noise_that_is_not_as_stated_is_found_beside_any_effect(bench, plan, sigma_px, effect):
    display, see_through = floors_of(measured(bench, plan, sigma_px, seed=1, **effect))
    for floor in (display, see_through):
        assert floor.stated_px == SIGMA_PX
        assert floor.within_px == pytest.approx(sigma_px, rel=0.06)
        assert not floor.is_believable
        assert floor.used_px == floor.measured_px
    assert display.repeats_px == pytest.approx(sigma_px, rel=0.15)  # of two photographs only
    assert np.isnan(see_through.repeats_px)
    assert (display.part, see_through.part) == ("display", "see-through")


def test_noise_as_stated_is_believed(bench, plan):
    for floor in floors_of(measured(bench, plan, SIGMA_PX, seed=2)):
        assert floor.is_believable
        assert floor.used_px == SIGMA_PX


def drawn(clean, sigma_px, seed):
    """A residual of white noise, in units of the stated sigma."""
    return sigma_px / SIGMA_PX * np.random.default_rng(seed).normal(size=(len(clean), 2))


def excesses(observations, residual):
    return excess_over_noise(observations, residual, np.ones(len(observations), dtype=bool))


@pytest.mark.parametrize("larger", [1.0, 1.04, 1.06, 1.08, 1.1, 1.2])
def test_noise_larger_than_stated_is_never_both_believed_and_exceeded(clean, larger):
    """Whether the stated or the measured noise is used, white noise is no excess over it."""
    believed = []
    for seed in range(20):
        residual = drawn(clean, larger * SIGMA_PX, seed)
        floors = noise_floors(clean, residual)
        used = np.array([floor.used_px for floor in floors])[clean.part][:, None] / SIGMA_PX
        assert not any(excess.is_significant for excess in excesses(clean, residual / used).values())
        believed += [floor.is_believable for floor in floors]
    assert np.mean(believed) > 0.95 or larger > 1.0
    assert np.mean(believed) < 0.05 or larger < 1.2


@pytest.mark.parametrize(
    ("kind", "most"), [("heavy tails", 0.1), ("differs between photographs", 0.05), ("rises over the field", 0.3)]
)
def test_noise_that_is_not_gaussian_or_not_even_is_seldom_an_excess(clean, kind, most):
    """Three times the noise at the edge as in the centre is called more than noise now and then: a known limit."""
    found = []
    for seed in range(20):
        rng, residual = np.random.default_rng(100 + seed), drawn(clean, SIGMA_PX, seed)
        if kind == "heavy tails":
            residual = rng.standard_t(3, residual.shape)
        elif kind == "differs between photographs":
            residual *= np.where(rng.random(len(clean.captures)) < 0.3, 3.0, 1.0)[clean.group][:, None]
        else:
            plan = clean.session.plan
            pixel = np.concatenate([plan.display.camera_pixel, clean.session.readings.dot_pixel])
            radius = np.linalg.norm(pixel - [640, 512], axis=1)
            residual *= (1 + 2 * (radius / radius.max()) ** 2)[:, None]
        used = ~outlier_readings(clean, residual)
        found += [excess.is_significant for excess in excess_over_noise(clean, residual, used).values()]
    assert np.mean(found) <= most


def test_a_smooth_residual_of_half_the_noise_is_an_excess_in_its_part_only(clean):
    plan = clean.session.plan.display
    for seed in range(5):
        residual = drawn(clean, SIGMA_PX, seed)
        residual[clean.part == DISPLAY, 0] += np.sin(plan.camera_pixel[:, 0] / 150)
        found = excesses(clean, residual)
        assert found[DISPLAY].is_significant
        assert not found[SEE_THROUGH].is_significant
        assert found[DISPLAY].noise == pytest.approx(1.0, abs=0.15)


def test_an_effect_in_two_captures_alone_is_an_excess(clean):
    """The error of the test is that of noise: it must not grow with what is to be found."""
    residual = drawn(clean, SIGMA_PX, 3)
    residual[np.isin(clean.group, [16, 17])] += 3.0
    assert excesses(clean, residual)[DISPLAY].is_significant


def test_the_excess_of_white_noise_scatters_by_its_stated_error(clean):
    ratios = []
    for seed in range(60):
        for excess in excesses(clean, drawn(clean, SIGMA_PX, seed)).values():
            ratios.append((excess.mean_square - excess.noise) / excess.error)
    assert np.mean(ratios) == pytest.approx(0.0, abs=0.3)
    assert np.std(ratios) == pytest.approx(1.0, abs=0.2)


def test_too_few_points_are_compared_with_sigma(clean):
    few = clean.of_rows(clean.spread(200))
    for factor, significant in ((1.0, False), (1.6, True)):
        found = excesses(few, factor * drawn(few, SIGMA_PX, 1))
        assert all(excess.is_significant == significant and excess.noise == 1.0 for excess in found.values())


def test_a_difference_must_be_both_sure_and_large():
    assert is_significant(0.2, 0.05)
    assert is_significant(-0.2, 0.05)
    assert not is_significant(0.2, 0.1)
    assert not is_significant(0.05, 0.001)
    assert not is_significant(0.2, 0.05, reference=4.0)


def test_few_repeats_do_not_override_the_scatter_within_photographs(bench, plan):
    """Over draws: the combined noise is nearer the truth than either, and stated noise that is true is believed."""
    exact = measured(bench, SessionPlan(display=plan.display))
    found = [noise_floors(exact, drawn(exact, SIGMA_PX, seed))[0] for seed in range(60)]
    repeats, within, both = (
        np.std([getattr(floor, name) for floor in found]) for name in ("repeats_px", "within_px", "measured_px")
    )
    assert both < within < repeats
    assert both == pytest.approx(np.mean([floor.error_px for floor in found]), rel=0.35)
    assert np.mean([floor.is_believable for floor in found]) > 0.95


def test_a_pattern_finer_than_the_points_is_no_noise_where_repeats_tell(bench, plan):
    exact = measured(bench, SessionPlan(display=plan.display))
    residual = drawn(exact, SIGMA_PX, 5)
    # The same in each photograph of one place, and rough within it.
    pattern = np.random.default_rng(6).normal(0, 2, (len(exact) // 18, 2))
    floor = noise_floors(exact, residual + np.tile(pattern, (18, 1)))[0]
    assert floor.within_px > 2 * SIGMA_PX
    assert floor.measured_px == floor.repeats_px == pytest.approx(SIGMA_PX, rel=0.2)


def test_the_noise_to_go_by_is_that_of_the_parts_that_are_there(clean):
    floors = (NoiseFloor("see-through", 0.1, 0.3, np.nan, 0.3, 0.01, 0.3, False),)
    np.testing.assert_array_equal(sigma_of(floors, np.array([0.1, 0.1, 0.15])), [0.1, 0.3, 0.15])


def test_the_noise_between_repeats_is_scaled_by_how_often(bench, plan):
    """Averaged over draws: a deviation from the mean of two readings is smaller than the noise."""
    exact = measured(bench, SessionPlan(display=plan.display))
    found = [floors_of(measured(bench, SessionPlan(display=plan.display), 0.1, seed))[0] for seed in range(8)]
    assert np.mean([floor.repeats_px for floor in found]) == pytest.approx(0.1, rel=0.06)
    assert np.mean([floor.within_px for floor in found]) == pytest.approx(0.1, rel=0.02)
    assert floors_of(exact)[0].repeats_px < 1e-6


def test_too_few_points_in_a_photograph_give_no_noise_estimate(bench, plan):
    few = measured(bench, plan, SIGMA_PX)
    few = few.of_rows(few.spread(200))
    for floor in floors_of(few):
        assert np.isnan(floor.within_px)
        assert floor.used_px == SIGMA_PX
    assert not outlier_readings(few, nominal_residual(few)).any()


class TestOutlierReadings:
    def test_exactly_those_injected_are_found_beside_any_effect(self, bench, plan):
        """At the corner, at the edge, in the middle of a photograph, in repeats, and two in one photograph."""
        observations = measured(bench, plan, SIGMA_PX, seed=3, combiner_tilt=[1.0, 1.0, 1.0])
        display, dots = np.array([0, 5, 100, 540, 901, 930]), np.array([7, 300, 600])
        read = observations.session.readings
        read.panel_pixel[display] += [12.0, -5.0]
        read.dot_pixel[dots] += [3.0, -2.0]
        found = np.flatnonzero(outlier_readings(observations, nominal_residual(observations)))
        first_dot = np.count_nonzero(observations.part == DISPLAY)
        np.testing.assert_array_equal(found, np.concatenate([display, first_dot + dots]))
        floors = floors_of(observations)
        assert all(floor.measured_px == pytest.approx(SIGMA_PX, rel=0.15) for floor in floors)

    @pytest.mark.parametrize("effect", EFFECTS, ids=lambda effect: "+".join(effect) or "nothing")
    def test_none_are_found_where_there_are_none(self, bench, plan, effect):
        observations = measured(bench, plan, SIGMA_PX, seed=4, **effect)
        assert not outlier_readings(observations, nominal_residual(observations)).any()

    def test_more_noise_than_stated_is_no_outlier_reading(self, bench, plan):
        observations = measured(bench, plan, 5 * SIGMA_PX, seed=5)
        assert outlier_readings(observations, nominal_residual(observations)).sum() <= 2

    def test_a_capture_that_moved_is_no_outlier_reading(self, bench, plan):
        observations = measured(bench, plan, SIGMA_PX, seed=6)
        observations.session.readings.dot_pixel[observations.group[observations.part == SEE_THROUGH] == 20] += 20.0
        assert not outlier_readings(observations, nominal_residual(observations)).any()
