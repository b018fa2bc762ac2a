from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from flat_image import PrismPlate, TurnedDisplay
from numpy.typing import NDArray
from present import narrowed

from wlr_render.evaluation.misalignment import misalignment_arcmin
from wlr_render.geometry import directions, rays, transforms
from wlr_render.mappings import Eye
from wlr_render.numerics.arrays import FloatArray

VIEWPOINT = np.array([0.004, 0.001, 0.012])


def shown_points(eye: Eye, viewpoint: NDArray[Any], pixel: FloatArray, distance: FloatArray) -> FloatArray:
    """Points (..., 3) that a frame drawn for `eye` shows at its pixels, at some distance along the world rays."""
    view_dir = eye.display.view_dir_of_pixel(pixel, viewpoint).value
    origin, direction = rays.split(eye.see_through.real_ray_of_view_dir(view_dir, viewpoint).value)
    return origin + np.asarray(distance)[..., None] * direction


@pytest.mark.parametrize("shape", [(), (1,), (3, 1, 2)])
def test_a_frame_drawn_with_the_truth_is_not_misaligned(flat_image_headset: Eye, shape: tuple[int, ...]) -> None:
    rng = np.random.default_rng(1)
    pixel = rng.uniform(0, [140, 100], (*shape, 2))
    point = shown_points(flat_image_headset, VIEWPOINT, pixel, rng.uniform(0.3, 5.0, shape))
    error = misalignment_arcmin(flat_image_headset, VIEWPOINT, pixel, point)
    assert error.shape == shape
    assert np.max(error) < 1e-6


@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_a_turned_display_is_off_by_the_turn(flat_image_headset: Eye, axis: str) -> None:
    rng = np.random.default_rng(2)
    pixel = rng.uniform(0, [140, 100], (200, 2))
    turn = transforms.rotation_about(axis, 3 * directions.ARCMIN)
    believed = replace(flat_image_headset, display=TurnedDisplay(flat_image_headset.display, turn))
    point = shown_points(believed, VIEWPOINT, pixel, rng.uniform(0.3, 5.0, 200))
    error = misalignment_arcmin(flat_image_headset, VIEWPOINT, pixel, point)
    # A rotation moves a direction by its angle times the sine of the direction's angle from the axis.
    seen = flat_image_headset.display.view_dir_of_pixel(pixel, VIEWPOINT).value
    expected = 3 * np.sqrt(1 - seen[:, "xyz".index(axis)] ** 2)
    np.testing.assert_allclose(error, expected, rtol=1e-6)


def test_ignoring_the_combiner_gives_its_deviation_as_misalignment(flat_image_headset: Eye) -> None:
    """Straight rays instead of those of a plate that offsets by 2 mm per tangent and bends by 3 mrad."""
    pixel = np.array([[20.0, 30.0], [70.0, 50.0], [120.0, 90.0]])
    seen = flat_image_headset.display.view_dir_of_pixel(pixel, VIEWPOINT).value
    for distance in (0.5, 1e6):
        point = VIEWPOINT + distance * seen / -seen[:, 2:]
        error = misalignment_arcmin(flat_image_headset, VIEWPOINT, pixel, point)
        plate = narrowed(flat_image_headset.see_through, PrismPlate)
        tangents = directions.tangents_of_dir(seen)
        beyond = distance - (VIEWPOINT[2] - plate.z_m)
        bent = (distance * tangents - beyond * np.array([plate.prism, 0.0])) / (distance + plate.offset_m)
        expected = directions.arcmin_between(directions.dir_of_tangents(bent), seen)
        np.testing.assert_allclose(error, expected, rtol=1e-6)
    # Far away only the prism is left: 3 mrad across the line of sight.
    assert error[1] == pytest.approx(3e-3 / directions.ARCMIN, rel=0.01)


def test_misalignment_is_nan_for_background_and_invisible_points(flat_image_headset: Eye) -> None:
    pixel = np.tile([70.0, 50.0], (3, 1))
    point = np.tile([0.1, 0.0, -1.0], (3, 1))
    point[1] = np.nan
    pixel[2] = np.nan
    error = misalignment_arcmin(flat_image_headset, VIEWPOINT, pixel, point)
    np.testing.assert_array_equal(np.isnan(error), [False, True, True])
