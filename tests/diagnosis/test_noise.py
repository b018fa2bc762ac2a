"""How much of a session is noise, whatever else is in it; and single readings that went astray."""

import numpy as np
import pytest
from small_session import SIGMA_PX, measured

from wlr_render.captures.session import SessionPlan
from wlr_render.diagnosis.extension import Extension, Predictor
from wlr_render.diagnosis.noise import NoiseFloor, noise_floors, sigma_of, stray_readings
from wlr_render.diagnosis.observations import DISPLAY, SEE_THROUGH

EFFECTS = [
    {},
    {"combiner_tilt": [1.0, -1.0, 1.0], "target_bow": [1.0, 1.0]},
    {"headset_slip": [0.5, 0.0, 0.3, 0.2, 0.0, 0.0, 900.0]},  # between a place and its repetition
    {"thermal_drift": [0.05, 0.05, 600.0]},
]


def nominal_residual(observations):
    return Predictor(observations).residual(Extension())


def floors_of(observations):
    return noise_floors(observations, nominal_residual(observations))


@pytest.mark.parametrize("effect", EFFECTS, ids=lambda effect: "+".join(effect) or "nothing")
@pytest.mark.parametrize("sigma_px", [0.05, 0.2])
def test_noise_that_is_not_as_stated_is_found_beside_any_effect(bench, plan, sigma_px, effect):
    display, see_through = floors_of(measured(bench, plan, sigma_px, seed=1, **effect))
    for floor in (display, see_through):
        assert floor.stated_px == SIGMA_PX
        assert floor.within_px == pytest.approx(sigma_px, rel=0.06)
        assert not floor.believable
        assert floor.used_px == floor.measured_px
    assert display.repeats_px == pytest.approx(sigma_px, rel=0.15)  # of two photographs only
    assert np.isnan(see_through.repeats_px)
    assert (display.part, see_through.part) == ("display", "see-through")


def test_noise_as_stated_is_believed(bench, plan):
    for floor in floors_of(measured(bench, plan, SIGMA_PX, seed=2)):
        assert floor.believable
        assert floor.used_px == SIGMA_PX


def test_repeats_come_before_smoothness_and_either_before_the_statement():
    assert NoiseFloor("display", 0.1, 0.2, 0.1, 0.1).believable
    assert not NoiseFloor("display", 0.1, 0.1, 0.2, 0.2).believable
    assert not NoiseFloor("display", 0.1, 0.2, np.nan, 0.2).believable
    assert NoiseFloor("display", 0.1, np.nan, np.nan, 0.1).believable
    assert NoiseFloor("display", 0.1, 0.105, np.nan, 0.1).believable


def test_the_noise_to_go_by_is_that_of_the_parts_that_are_there(clean):
    floors = (NoiseFloor("see-through", 0.1, 0.3, np.nan, 0.3),)
    np.testing.assert_array_equal(sigma_of(floors, np.array([0.1, 0.1, 0.15])), [0.1, 0.3, 0.15])


def test_the_noise_between_repeats_is_scaled_by_how_often(bench, plan):
    """Averaged over draws: a deviation from the mean of two readings is smaller than the noise."""
    exact = measured(bench, SessionPlan(display=plan.display))
    found = [floors_of(measured(bench, SessionPlan(display=plan.display), 0.1, seed))[0] for seed in range(8)]
    assert np.mean([floor.repeats_px for floor in found]) == pytest.approx(0.1, rel=0.06)
    assert np.mean([floor.within_px for floor in found]) == pytest.approx(0.1, rel=0.02)
    assert floors_of(exact)[0].repeats_px < 1e-6


def test_too_few_points_in_a_photograph_tell_nothing(bench, plan):
    few = measured(bench, plan, SIGMA_PX)
    few = few.of_rows(few.spread(200))
    for floor in floors_of(few):
        assert np.isnan(floor.within_px)
        assert floor.used_px == SIGMA_PX
    assert not stray_readings(few, nominal_residual(few)).any()


class TestStrays:
    def test_exactly_those_injected_are_found_beside_any_effect(self, bench, plan):
        """At the corner, at the edge, in the middle of a photograph, in repeats, and two in one photograph."""
        observations = measured(bench, plan, SIGMA_PX, seed=3, combiner_tilt=[1.0, 1.0, 1.0])
        display, dots = np.array([0, 5, 100, 540, 901, 930]), np.array([7, 300, 600])
        read = observations.session.readings
        read.panel_pixel[display] += [12.0, -5.0]
        read.dot_pixel[dots] += [3.0, -2.0]
        found = np.flatnonzero(stray_readings(observations, nominal_residual(observations)))
        first_dot = np.count_nonzero(observations.part == DISPLAY)
        np.testing.assert_array_equal(found, np.concatenate([display, first_dot + dots]))
        floors = floors_of(observations)
        assert all(floor.measured_px == pytest.approx(SIGMA_PX, rel=0.15) for floor in floors)

    @pytest.mark.parametrize("effect", EFFECTS, ids=lambda effect: "+".join(effect) or "nothing")
    def test_none_are_found_where_there_are_none(self, bench, plan, effect):
        observations = measured(bench, plan, SIGMA_PX, seed=4, **effect)
        assert not stray_readings(observations, nominal_residual(observations)).any()

    def test_more_noise_than_stated_is_not_astray(self, bench, plan):
        observations = measured(bench, plan, 5 * SIGMA_PX, seed=5)
        assert stray_readings(observations, nominal_residual(observations)).sum() <= 2

    def test_a_capture_that_moved_is_not_astray(self, bench, plan):
        observations = measured(bench, plan, SIGMA_PX, seed=6)
        observations.session.readings.dot_pixel[observations.group[observations.part == SEE_THROUGH] == 20] += 20.0
        assert not stray_readings(observations, nominal_residual(observations)).any()
