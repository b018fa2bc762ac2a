"""SPAAM, DRC and INDICA on headsets that are what they assume."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from rival_headsets import EYE_BOX, IN_VOLUME, display_captures, see_through_captures
from scipy.spatial.transform import Rotation

from benchmarks.rivals.pinhole import direct_plane, indica_full, indica_recycle, spaam
from benchmarks.rivals.pinhole_models import PinholeDisplay
from wlr_render.captures.correspondences import Captures, select
from wlr_render.geometry.directions import arcmin_between, normalised
from wlr_render.mappings import Status
from wlr_render.numerics.arrays import FloatArray

EXACT = 1e-6  # arcminutes
RNG = np.random.default_rng(5)
PIXEL = RNG.uniform([50, 50], [950, 750], (40, 2))
VIEWPOINT = EYE_BOX.at(RNG.uniform(-1, 1, (40, 3)))
POINT = np.column_stack([VIEWPOINT[:, :2] + RNG.uniform(-0.1, 0.1, (40, 2)), RNG.uniform(-3, -0.3, 40)])
TURN = Rotation.from_rotvec([0.03, -0.05, 0.1]).as_matrix()


def screen(inverse_depth: float, shear: float = 0.0) -> Callable[[FloatArray, FloatArray], FloatArray]:
    """Direction of (pixel, viewpoint): a rectangular screen, sheared if asked, about 1 / inverse_depth away."""

    def direction(pixel: FloatArray, viewpoint: FloatArray) -> FloatArray:
        u, v = (pixel - [480.0, 410.0]).T
        on_screen = np.stack([6e-4 * u, -7e-4 * v + shear * 6e-4 * u, np.full(len(u), -1.0)], axis=1) @ TURN.T
        return np.asarray(on_screen - inverse_depth * (viewpoint - EYE_BOX.centre))

    return direction


def seen_error(model: PinholeDisplay, direction_of: Callable[..., Any]) -> float:
    """Arcminutes between a display's directions and the true ones, at other viewpoints and pixels."""
    found = model.view_dir_of_pixel(PIXEL, VIEWPOINT).value
    return float(arcmin_between(found, normalised(direction_of(PIXEL, VIEWPOINT))).max())


def eye_at(offset: FloatArray) -> Callable[[FloatArray, FloatArray], FloatArray]:
    """Tangents of (point, viewpoint): straight lines to an eye beside the viewpoint."""

    def tangents(point: FloatArray, viewpoint: FloatArray) -> FloatArray:
        to_point = point - (viewpoint + offset)
        return to_point[:, :2] / -to_point[:, 2:]

    return tangents


@pytest.mark.parametrize("inverse_depth", [1.4, 0.0, -0.8])
@pytest.mark.parametrize("fit", [direct_plane, indica_full])
def test_a_flat_image_is_recovered_also_at_and_beyond_infinity(fit: Callable[..., Any], inverse_depth: float) -> None:
    truth = screen(inverse_depth)
    model = fit(display_captures(IN_VOLUME[:5], truth))
    assert seen_error(model, truth) < EXACT
    back = model.pixel_of_view_dir(normalised(truth(PIXEL, VIEWPOINT)), VIEWPOINT)
    np.testing.assert_allclose(back.value, PIXEL, atol=1e-6)
    assert np.all(back.status == Status.OK)


def spaam_captures(positions: FloatArray, offset: FloatArray, inverse_depth: float = 1.4) -> Captures:
    return Captures(display_captures(positions, screen(inverse_depth)), see_through_captures(positions, eye_at(offset)))


def test_spaam_is_one_projection_for_all_viewpoints() -> None:
    """The optics shift the eye by 4 mm: the projection has its centre there, and no viewpoint moves it."""
    offset, nominal = np.array([4e-3, -2e-3, 1e-3]), EYE_BOX.centre[None]
    captures = spaam_captures(nominal, offset)
    twice = np.tile(np.arange(len(captures.both[1])), 2)  # the targets were photographed again
    display, see_through = spaam(Captures(captures.display, select(captures.both[1], twice)))
    eye = EYE_BOX.centre + offset
    np.testing.assert_allclose(see_through.eye, eye[None], atol=1e-9)
    seen = see_through.view_dir_of_real_point(POINT, VIEWPOINT)
    np.testing.assert_allclose(seen.value, normalised(POINT - eye), atol=1e-9)
    pixel = display.pixel_of_view_dir(seen.value, VIEWPOINT).value
    direction = normalised(screen(1.4)(pixel, np.broadcast_to(EYE_BOX.centre, VIEWPOINT.shape)))
    assert arcmin_between(direction, normalised(POINT - eye)).max() < EXACT
    ray = see_through.real_ray_of_view_dir(seen.value, VIEWPOINT).value
    np.testing.assert_allclose(np.cross(POINT - ray[:, :3], ray[:, 3:]), 0.0, atol=1e-9)


def test_recycled_spaam_follows_the_eye_when_the_screen_lies_across_its_axis() -> None:
    captures = spaam_captures(np.concatenate([EYE_BOX.centre[None], IN_VOLUME[:4]]), np.zeros(3))
    assert seen_error(spaam(captures)[0], screen(1.4)) > 10.0
    assert seen_error(indica_recycle(captures), screen(1.4)) < EXACT
