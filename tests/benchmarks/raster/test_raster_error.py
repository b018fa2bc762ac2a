"""Registration error of frames whose world points are known."""

import numpy as np
import pytest

from benchmarks.raster.raster_error import raster_error
from wlr_render.geometry import directions, transforms
from wlr_render.geometry.pinhole import Pinhole
from wlr_render.numerics.arrays import FloatArray
from wlr_render.warp.view import View


@pytest.fixture
def view() -> View:
    camera = Pinhole(100, 80, np.array([-0.5, -0.4]), np.array([0.5, 0.4]))
    pose = transforms.rigid(transforms.rotation_about("y", 0.7), np.array([1.0, 1.6, -0.2]))
    return View(camera, np.array([0.03, 0.0, -0.02]), pose)


def points_at(view: View, depth: float) -> FloatArray:
    """World points that the view's pixel centres see on the plane at `depth`."""
    tangents = view.camera.pixel_centre_tangents()
    in_camera = np.concatenate([tangents, -np.ones((*tangents.shape[:2], 1))], axis=-1) * depth
    return transforms.apply(view.world_from_camera, in_camera)


def test_a_known_shift_comes_back_in_arcminutes(view: View) -> None:
    points = points_at(view, 2.0)
    turn = transforms.rotation_about("y", 3 * directions.ARCMIN)
    turned = (points - view.position_in_world) @ turn.T + view.position_in_world
    error = raster_error(points, turned, view.position_in_world)
    # A turn about the vertical moves a point by the sine of its angle from the vertical.
    along = directions.normalised(points - view.position_in_world)[..., 1]
    np.testing.assert_allclose(error.registration_arcmin, 3 * np.sqrt(1 - along**2), rtol=1e-6)


def test_holes_are_counted_once_and_have_no_angle(view: View) -> None:
    points = points_at(view, 2.0)
    warped = points.copy()
    warped[5, 5] = np.nan
    points[6, 6] = np.nan
    points[7, 7] = warped[7, 7] = np.nan
    error = raster_error(warped, points, view.position_in_world)
    assert np.argwhere(error.only_one).tolist() == [[5, 5], [6, 6]]
    assert np.argwhere(np.isnan(error.registration_arcmin)).tolist() == [[5, 5], [6, 6], [7, 7]]
