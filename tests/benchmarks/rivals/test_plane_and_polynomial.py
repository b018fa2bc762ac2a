"""Wientapper's plane and polynomial on headsets that are one."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from rival_headsets import EYE_BOX, IN_PLANE, IN_VOLUME, display_captures

from benchmarks.rivals.pinhole import direct_plane
from benchmarks.rivals.plane_and_polynomial import wientapper_display
from wlr_render.geometry.directions import arcmin_between, dir_of_tangents, tangents_of_dir
from wlr_render.models.fitted_model import FittedDisplay
from wlr_render.numerics.arrays import FloatArray

RNG = np.random.default_rng(5)
PIXEL = RNG.uniform([60, 60], [940, 740], (200, 2))
VIEWPOINT = EYE_BOX.at(RNG.uniform(-0.8, 0.8, (200, 3)))


def distorted(amplitude: float) -> Callable[[FloatArray, FloatArray], FloatArray]:
    """Direction of (pixel, viewpoint): a screen 0.7 m away and a cubic of pixel and position in tangents."""

    def direction(pixel: FloatArray, viewpoint: FloatArray) -> FloatArray:
        u, v = ((pixel - [500.0, 400.0]) / 500.0).T
        shift = viewpoint - EYE_BOX.centre
        x, y, z = (shift / EYE_BOX.size).T
        screen = np.stack([0.3 * u, -0.3 * v, np.full(len(u), -1.0)], axis=1) - 1.4 * shift
        rest = np.stack([u * u * x + 0.5 * z * v, u * v * y - x * x + 0.3 * v**3], axis=1)
        return dir_of_tangents(tangents_of_dir(screen) + amplitude * rest)

    return direction


def error(model: FittedDisplay, truth: Callable[..., Any]) -> float:
    return float(arcmin_between(model.view_dir_of_pixel(PIXEL, VIEWPOINT).value, truth(PIXEL, VIEWPOINT)).max())


@pytest.mark.parametrize(("bundled", "positions"), [(False, IN_VOLUME), (True, IN_PLANE)])
def test_a_plane_alone_is_recovered(bundled: bool, positions: FloatArray) -> None:
    truth = distorted(0.0)
    captures = display_captures(positions, truth)
    model, regressor = wientapper_display(captures, bundled)
    assert error(model, truth) < 1e-5
    back = model.pixel_of_view_dir(truth(PIXEL, VIEWPOINT), VIEWPOINT)
    np.testing.assert_allclose(back.value, PIXEL, atol=1e-5)
    assert regressor.numbers >= 11


def test_the_polynomial_explains_what_the_plane_leaves() -> None:
    """The best plane of the distorted image is another: the polynomial takes that up, too, to a hundredth."""
    truth = distorted(5e-3)
    captures = display_captures(np.concatenate([IN_VOLUME, EYE_BOX.at(RNG.uniform(-1, 1, (50, 3)))]), truth)
    plane = error(direct_plane(captures), truth)
    model, regressor = wientapper_display(captures)
    assert plane > 5.0
    assert error(model, truth) < 0.01 * plane
    assert regressor.numbers in (11 + 2 * 56, 11 + 2 * 126, 11 + 2 * 252)  # degree 3, 4 or 5
    assert wientapper_display(captures, degree=1)[1].numbers == 11 + 2 * 6
    assert error(wientapper_display(captures, degree=1)[0], truth) > 0.5 * plane
