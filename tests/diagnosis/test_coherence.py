"""What different captures have in common at one place is found where it sits; noise has nothing in common."""

from dataclasses import replace

import numpy as np
import pytest
from small_session import SIGMA_PX, measured, with_readings

from wlr_render.captures.session import SessionPlan, select_rows
from wlr_render.diagnosis.coherence import fine_effect
from wlr_render.diagnosis.combiner_fields import footprints
from wlr_render.diagnosis.observations import DISPLAY
from wlr_render.diagnosis.prediction import Explanation, Predictor

PLACE_MM = np.array([2.0, -1.5])


def of(observations):
    predictor = Predictor(observations)
    return fine_effect(predictor, predictor.residual(Explanation()), 2.0)


def spotted(observations, radius_mm=2.0, size_px=1.0):
    """Display readings that are off, all the same way, inside a circle with a hard edge on the combiner."""
    inside = np.linalg.norm(footprints(Predictor(observations)) - PLACE_MM, axis=1) < radius_mm
    rows = observations.part == DISPLAY
    off = np.where(inside[rows, None], [size_px, -0.5 * size_px], 0.0)
    shown = (observations.panel_from_camera @ off[:, :, None])[:, :, 0]
    return with_readings(observations, panel_pixel=observations.session.readings.panel_pixel + shown)


def denser(plan, times=4):
    """The display read at so many times as many pixels, between those of the plan."""
    table = select_rows(plan.display, np.repeat(np.arange(len(plan.display)), times))
    apart = 40.0 * np.random.default_rng(1).uniform(-1, 1, (len(table), 2))
    return SessionPlan(replace(table, camera_pixel=table.camera_pixel + apart), plan.see_through)


def test_a_spot_on_the_combiner_is_found_at_its_place(bench, plan):
    found = of(spotted(measured(bench, denser(plan), SIGMA_PX, seed=12)))
    assert (found.station, found.part) == ("combiner", "display")
    assert found.log10_odds > 5
    np.testing.assert_allclose(found.place, PLACE_MM, atol=0.75)
    assert found.width < 2.0
    assert found.improvement.percent > 0
    assert len(found.cells) == len(found.means)


@pytest.mark.parametrize("seed", [13, 14, 15])
def test_noise_with_long_tails_has_nothing_in_common(bench, plan, seed):
    clean, rng = measured(bench, plan), np.random.default_rng(seed)
    read = clean.session.readings
    kick = SIGMA_PX * rng.standard_t(4.0, size=read.panel_pixel.shape)
    noisy = with_readings(
        clean,
        panel_pixel=read.panel_pixel + (clean.panel_from_camera @ kick[:, :, None])[:, :, 0],
        dot_pixel=read.dot_pixel + SIGMA_PX * rng.standard_t(4.0, size=read.dot_pixel.shape),
    )
    assert of(noisy) is None


def test_one_wild_reading_is_no_spot(bench, plan):
    observations = measured(bench, plan, SIGMA_PX, seed=16)
    pixel = observations.session.readings.panel_pixel.copy()
    pixel[100] += 60.0
    assert of(with_readings(observations, panel_pixel=pixel)) is None
