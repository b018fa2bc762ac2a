"""Lenses of 120 and of 180 degrees: the kind is found, and directions are right to the last feature."""

from dataclasses import replace

import numpy as np
import pytest
from calibration.bench.wide_lens import CENTRE, SIZE, WideLens
from present import narrowed

from wlr_render.calibration.bench.adjustment import adjust
from wlr_render.calibration.bench.board_views import EYEBALL, BenchObservations, CameraSetup
from wlr_render.calibration.bench.lenses import sound_views
from wlr_render.calibration.bench.start import board_pose, start_state
from wlr_render.captures.boards.board import USUAL_TOLERANCES
from wlr_render.lenses.lens_camera import LensCamera


@pytest.mark.slow
@pytest.mark.parametrize("field_deg", [120, 180])
def test_a_wide_lens_is_found_to_the_last_feature(field_deg: int) -> None:
    true = WideLens(field_deg)
    views = true.views()
    alone = BenchObservations(views, {EYEBALL: CameraSetup(SIZE)}, {}, (), tolerances={"board": USUAL_TOLERANCES})
    sound = sound_views(views, alone.cameras[EYEBALL], alone)
    assert narrowed(sound.lens, LensCamera).kind == "fisheye"
    assert not sound.rejected
    found = adjust(start_state(replace(alone, views=sound.views), {EYEBALL: sound.lens}))
    assert found.sizes.noise[EYEBALL] == pytest.approx(1.0, abs=0.1)
    farthest = max(np.linalg.norm(view.pixel - CENTRE, axis=1).max() for view in views)
    u, v = np.meshgrid(np.linspace(5, SIZE[0] - 5, 41), np.linspace(5, SIZE[1] - 5, 33))
    pixel = np.stack([u.ravel(), v.ravel()], axis=-1)
    pixel = pixel[np.linalg.norm(pixel - CENTRE, axis=1) < farthest]
    expected = true.direction(pixel)
    assert np.degrees(np.arccos(expected[:, 2].min())) > 0.5 * field_deg
    off = np.degrees(np.linalg.norm(found.state.lens[EYEBALL].dir_of_pixel(pixel) - expected, axis=1)) * 60
    # The largest is of one pixel at the rim: 0.22' to 0.43' in five draws of the noise.
    assert np.sqrt(np.mean(off**2)) < 0.13
    assert np.quantile(off, 0.99) < 0.25


def test_a_board_is_placed_beyond_90_degrees_off_axis() -> None:
    lens = LensCamera(SIZE, np.full(2, 300.0), CENTRE, np.zeros(4), "fisheye")
    view = WideLens(180).views()[0]
    away = np.array([0.4, 0.0, -0.1])
    turn = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    point = view.point @ turn.T + away
    assert np.all(np.degrees(np.arctan2(np.linalg.norm(point[:, :2], axis=1), point[:, 2])) > 75)
    pose, scale = board_pose(lens, replace(view, pixel=lens.pixel_of_point(point)))
    np.testing.assert_allclose(pose[:3, 3], away, atol=1e-6)
    assert scale < 1e-3
