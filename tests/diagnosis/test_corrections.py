"""Smooth corrections: an effect that no cause explains is bound to the variable that it is a function of."""

import numpy as np
import pytest
from small_session import SIGMA_PX, explanation, fitted, measured, weighed, with_jitter, with_readings

from wlr_render.diagnosis.causes import CAUSES
from wlr_render.diagnosis.corrections import corrections, odds_beside
from wlr_render.diagnosis.observations import DISPLAY, RUN_TIME, SEE_THROUGH
from wlr_render.diagnosis.prediction import Explanation

SIZE = 4.0  # of the injected effects, in units of sigma


def wave(variable, period):
    return np.sin(2 * np.pi * variable / period)


def panel(plan, read):
    """Waves over the panel, as of a warped one."""
    return wave(read.panel_pixel[:, 0], 1000) * wave(read.panel_pixel[:, 1], 900)


def stripes(plan, read):
    """A few of every 64 pixels are off, as where one stripe of a Gray code is misread."""
    return np.where(np.mod(read.panel_pixel[:, 0], 64) < 5, 1.5, 0.0)


def image(plan, read):
    """Waves over the camera's image, as of a lens that is not radial."""
    return wave(plan.display.camera_pixel[:, 0], 700) * wave(plan.display.camera_pixel[:, 1], 600)


def screw(plan, read):
    """A stage whose screw of 1 mm lead is out of round."""
    return wave(plan.display.stage[:, 0] + 2e-4, 1e-3)


def hump(plan, read):
    """A stage that is bent."""
    return ((plan.display.stage[:, 0] - plan.display.stage[:, 0].mean()) / 4e-3) ** 2


def drift(plan, read):
    """A swing in time."""
    return wave(plan.display.time_s, 700)


def colour(plan, read):
    """Red alone is magnified."""
    return (plan.display.channel == 0) * (read.panel_pixel[:, 0] - 700) / 500


def warped_print(plan, read):
    """A print that is warped in one way on one target and in the opposite way on the other."""
    return (plan.see_through.dot[:, 0] / 0.1) ** 3 * (1 - 2 * plan.see_through.target_pose)


def dot_image(plan, read):
    """Waves over the camera's image in the dots."""
    return wave(read.dot_pixel[:, 0], 200) * wave(read.dot_pixel[:, 1], 200)


def dot_stage(plan, read):
    """A stage that runs too far, in the dots."""
    return (plan.see_through.stage[:, 0] - plan.see_through.stage[:, 0].mean()) / 4e-3


BOUND = [
    (DISPLAY, panel, "panel pixels"),
    (DISPLAY, stripes, "panel pixels"),
    (DISPLAY, image, "camera pixels"),
    (DISPLAY, screw, "stage"),
    (DISPLAY, hump, "stage"),
    (DISPLAY, drift, "time"),
    (DISPLAY, colour, "colour"),
    (SEE_THROUGH, warped_print, "target"),
    (SEE_THROUGH, dot_image, "camera pixels"),
    (SEE_THROUGH, dot_stage, "stage"),
]


@pytest.fixture(scope="module")
def noisy(bench, plan):
    """Observations of a bench with nothing wrong."""
    return measured(bench, plan, SIGMA_PX, seed=3)


def of(observations, part, effect=None, size=SIZE):
    """Corrections of a part that is off by an effect in sigma."""
    plan, read = observations.session.plan, observations.session.readings
    if effect is not None:
        off = SIGMA_PX * size * np.stack([effect(plan, read), np.zeros(np.sum(observations.part == part))], axis=-1)
        if part == DISPLAY:
            shown = (observations.panel_from_camera @ off[:, :, None])[:, :, 0]
            observations = with_readings(observations, panel_pixel=read.panel_pixel + shown)
        else:
            observations = with_readings(observations, dot_pixel=read.dot_pixel + off)
    return [each.correction for each in corrections(weighed(observations), fitted(observations, Explanation()), part)]


@pytest.mark.parametrize(("part", "effect", "variable"), BOUND, ids=[each[1].__name__ for each in BOUND])
def test_an_effect_is_bound_to_its_variable(noisy, part, effect, variable):
    first = of(noisy, part, effect)[0]
    assert first.depends_on == variable
    assert first.log10_odds > 10
    assert first.improvement.percent > 10
    assert first.improvement.significance > 2.5


@pytest.mark.parametrize("part", [DISPLAY, SEE_THROUGH])
def test_noise_and_a_shaky_camera_have_odds_for_no_correction(bench, noisy, part):
    """A camera that stands 20 micrometres elsewhere in each capture is no function of anything."""
    for observations in (noisy, with_jitter(noisy, bench, 20.0, np.random.default_rng(4), dof=4.0)):
        found = of(observations, part)
        assert len(found) >= 4
        assert all(each.log10_odds < 1.0 for each in found)
        odds = [each.log10_odds for each in found]
        assert odds == sorted(odds, reverse=True)


def test_odds_grow_with_the_effect(noisy):
    odds = [of(noisy, DISPLAY, panel, size)[0].log10_odds for size in (0.1, 0.5, 1.0)]
    assert odds[0] < 2.0 < odds[1] < odds[2]


def test_a_single_capture_allows_no_correction(noisy):
    assert of(noisy.of_rows(noisy.group == 0), DISPLAY) == []


def test_run_time_errors_can_be_bound_as_well(bench, run_time):
    observations = measured(bench, run_time, SIGMA_PX, seed=6)
    read, camera = observations.session.readings.run_time_pixel.copy(), observations.nominal.camera
    read[:, 1] += SIGMA_PX * 30 * camera.tangents_of_pixel(read[:, 2:])[:, 0] ** 2 * SIZE
    first = of(with_readings(observations, run_time_pixel=read), RUN_TIME)[0]
    assert (first.part, first.depends_on) == ("run-time", "camera pixels")
    assert first.improvement.percent > 10


def test_a_cause_that_smooth_functions_imitate_has_no_odds_beside_them(noisy, bench, plan):
    """A tilted combiner is no wave over the panel; the panel's scale, where it has waves, is but their match."""
    true = measured(bench, plan, SIGMA_PX, seed=3, combiner_tilt=[0.3, -0.2, 0.3])
    for observations, name, alone in ((true, "combiner_tilt", True), (noisy, "panel_scale", False)):
        read = observations.session.readings
        wavy = with_readings(observations, panel_pixel=read.panel_pixel + 3.0 * panel(plan, read)[:, None])
        found = fitted(wavy, explanation(**{name: CAUSES[name].null()}))
        readings, nothing = weighed(wavy), fitted(wavy, Explanation())
        beside = corrections(readings, nothing, DISPLAY)[0]
        if alone:
            beside = corrections(readings, found, DISPLAY)[0]
        odds = odds_beside(readings, found, 0, beside)
        assert (odds > 10) == alone
        assert (odds < 2) == (not alone)
