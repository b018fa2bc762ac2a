"""Smooth corrections: an effect that no cause explains is bound to the variable that it is a function of."""

import numpy as np
import pytest
from small_session import SIGMA_PX, measured

from wlr_render.diagnosis.corrections import corrections
from wlr_render.diagnosis.observations import DISPLAY, RUN_TIME, SEE_THROUGH
from wlr_render.diagnosis.prediction import Explanation, Predictor

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
    """Observations of a bench with nothing wrong, and their residual."""
    observations = measured(bench, plan, SIGMA_PX, seed=3)
    return observations, Predictor(observations).residual(Explanation())


def of(noisy, part, effect=None):
    observations, residual = noisy
    plan, read = observations.session.plan, observations.session.readings
    if effect is not None:
        residual = residual.copy()
        residual[observations.part == part, 0] += SIZE * effect(plan, read)
    return corrections(observations, residual, np.ones(len(residual), dtype=bool), part)


@pytest.mark.parametrize(("part", "effect", "variable"), BOUND, ids=[each[1].__name__ for each in BOUND])
def test_an_effect_is_bound_to_its_variable(noisy, part, effect, variable):
    first = of(noisy, part, effect)[0]
    assert first.depends_on == variable
    assert first.improvement.percent > 10
    assert first.improvement.significance > 2.5


@pytest.mark.parametrize("part", [DISPLAY, SEE_THROUGH])
def test_noise_gains_nothing_by_any_correction(noisy, part):
    """Held-out captures punish every free term that noise has been fitted with."""
    found = of(noisy, part)
    assert len(found) >= 4
    assert all(each.improvement.percent < 0.5 for each in found)
    assert [each.improvement.percent for each in found] == sorted(
        [each.improvement.percent for each in found], reverse=True
    )


def test_readings_that_do_not_count_do_not_matter(noisy):
    observations, residual = noisy
    used = np.random.default_rng(5).random(len(residual)) < 0.7
    spoilt = residual.copy()
    spoilt[~used] = np.nan
    fine, also = (corrections(observations, each, used, DISPLAY) for each in (residual, spoilt))
    assert [each.improvement for each in fine] == [each.improvement for each in also]


def test_captures_too_few_for_the_folds_allow_no_correction(noisy):
    observations, residual = noisy
    assert corrections(observations, residual, observations.group < 7, DISPLAY) == []


def test_run_time_errors_can_be_bound_as_well(bench, run_time):
    observations = measured(bench, run_time, SIGMA_PX, seed=6)
    residual = Predictor(observations).residual(Explanation())
    camera = observations.nominal.camera
    residual[:, 1] += 30 * camera.tangents_of_pixel(observations.session.readings.seen[:, 2:])[:, 0] ** 2 * SIZE
    first = corrections(observations, residual, np.ones(len(residual), dtype=bool), RUN_TIME)[0]
    assert (first.part, first.depends_on) == ("run-time", "camera pixels")
    assert first.improvement.percent > 10
