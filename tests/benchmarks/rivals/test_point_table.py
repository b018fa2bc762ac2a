"""Klemm's table of points on headsets whose virtual image is a surface."""

from collections.abc import Callable
from typing import Any

import numpy as np
from rival_headsets import EYE_BOX, IN_PLANE, display_captures

from benchmarks.rivals.point_table import klemm_grid
from wlr_render.geometry.directions import arcmin_between, dir_of_tangents
from wlr_render.models.point_per_pixel import PointPerPixelDisplay
from wlr_render.numerics.arrays import FloatArray

RNG = np.random.default_rng(5)
PIXEL = RNG.uniform([60, 60], [940, 740], (200, 2))
VIEWPOINT = EYE_BOX.at(RNG.uniform(-1, 1, (200, 3)))
EXACT = 1e-6  # arcminutes


def surface(curvature: float, twist: float = 0.01) -> Callable[[FloatArray, FloatArray], FloatArray]:
    """Directions of an image from one metre in front of the eye to beyond infinity; its tangents are curved."""

    def direction(pixel: FloatArray, viewpoint: FloatArray) -> FloatArray:
        x, y = ((pixel - [500.0, 400.0]) / 500.0).T
        a = np.stack([0.3 * x + twist * x * y + curvature * y**2, -0.35 * y], axis=1)
        w = (0.4 + 0.7 * x)[:, None]
        shift = viewpoint - EYE_BOX.centre
        return dir_of_tangents((a - w * shift[:, :2]) / (1.0 + w * shift[:, 2:]))

    return direction


def error(model: PointPerPixelDisplay, truth: Callable[..., Any]) -> float:
    return float(arcmin_between(model.view_dir_of_pixel(PIXEL, VIEWPOINT).value, truth(PIXEL, VIEWPOINT)).max())


def test_points_between_nodes_are_found_from_all_viewpoints() -> None:
    """The image is bilinear in the pixel, as the table is: its nodes' points are exact, off the plane, too."""
    truth = surface(0.0)
    model = klemm_grid(display_captures(IN_PLANE[:9], truth))
    assert error(model, truth) < EXACT
    back = model.pixel_of_view_dir(truth(PIXEL, VIEWPOINT), VIEWPOINT)
    np.testing.assert_allclose(back.value, PIXEL, atol=1e-6)
    assert model.point.numbers == 3 * 25 * 21
