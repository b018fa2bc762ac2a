from collections.abc import Sequence

import numpy as np
import pytest
from numpy.typing import ArrayLike

from wlr_render.geometry import transforms
from wlr_render.geometry.pinhole import Pinhole
from wlr_render.mappings import Eye, Panel
from wlr_render.numerics.arrays import Float32Array, FloatArray
from wlr_render.optics.device_file import load_device
from wlr_render.optics.traced_mappings import traced_eye
from wlr_render.warp.grid import WarpGrid
from wlr_render.warp.raster_camera import (
    MAX_SAMPLES,
    RasterPosition,
    largest_minification,
    nearest_point_to_rays,
    samples_for,
)
from wlr_render.warp.ray_map import middle_axes, solve_pixels
from wlr_render.warp.warp import SPACING_PX


def traced(device: str) -> Eye:
    return traced_eye(load_device(device), "right")


def offsets(slope_offset: FloatArray, place: FloatArray) -> FloatArray:
    """Offsets of rays (4, ...) from a point, across the viewing axis: followed to the point's depth."""
    a, b, c, d = slope_offset
    depth = -place[2]
    return np.asarray(np.hypot(c + a * depth - place[0], d + b * depth - place[1]))


def rays_through(point: FloatArray, tangents: FloatArray) -> FloatArray:
    """(4, ...) of rays with tangents (..., 2) through a point of the camera frame."""
    return np.moveaxis(np.concatenate([tangents, point[:2] + point[2] * tangents], axis=-1), -1, 0)


def test_rays_through_one_point_give_that_point() -> None:
    point = np.array([0.001, -0.002, -0.003])
    tangents = np.random.default_rng(0).normal(size=(5, 4, 2))
    slope_offset = rays_through(point, tangents)
    assert offsets(slope_offset, point).max() < 1e-15
    np.testing.assert_allclose(nearest_point_to_rays(slope_offset), point, atol=1e-15)
    slope_offset[:, 2, 1] = np.nan
    np.testing.assert_allclose(nearest_point_to_rays(slope_offset), point, atol=1e-15)


def test_no_other_point_is_nearer() -> None:
    rng = np.random.default_rng(1)
    slope_offset = rng.normal(size=(4, 30))
    best = nearest_point_to_rays(slope_offset)
    least = np.sum(offsets(slope_offset, best) ** 2)
    for step in 1e-3 * np.concatenate([np.eye(3), -np.eye(3), rng.normal(size=(6, 3))]):
        assert np.sum(offsets(slope_offset, best + step) ** 2) > least


def test_parallel_rays_or_none_move_nothing_along_the_axis() -> None:
    parallel = np.array([[0.1, 0.1], [0.2, 0.2], [1e-3, 3e-3], [0.0, 0.0]])
    np.testing.assert_allclose(nearest_point_to_rays(parallel), [2e-3, 0, 0], atol=1e-15)
    np.testing.assert_array_equal(nearest_point_to_rays(np.full((4, 3), np.nan)), np.zeros(3))


@pytest.mark.parametrize("device", ["no_optics", "flat_mirror"])
def test_without_deviation_the_raster_camera_is_at_the_viewpoint(device: str) -> None:
    eye = traced(device)
    viewpoint = eye.eye_box.at(np.array([0.3, -0.8, 0.5]))
    np.testing.assert_allclose(RasterPosition(eye, middle_axes(eye)).at(viewpoint), viewpoint, atol=1e-12)


def test_a_plane_plate_brings_the_eye_nearer_by_its_apparent_shift() -> None:
    eye = traced("plane_plate")
    thickness, n = 0.005, 1.5
    viewpoint = eye.eye_box.centre
    narrow = eye.display.panel.size_px * (0.5 + 0.02 * np.array([[-1, -1], [1, -1], [-1, 1], [1, 1]]))
    slope_offset = solve_pixels(eye, np.eye(3), narrow, viewpoint).slope_offset
    np.testing.assert_allclose(
        nearest_point_to_rays(np.moveaxis(slope_offset, -1, 0)), [0, 0, -thickness * (1 - 1 / n)], atol=1e-6
    )


@pytest.mark.parametrize("device", ["northstar", "freeform40", "birdbath28", "tilted_plate"])
def test_rays_pass_the_raster_eye_much_nearer_than_the_viewpoint(device: str) -> None:
    eye = traced(device)
    axes = middle_axes(eye)
    raster_position = RasterPosition(eye, axes)
    for unit in ([0.2, -0.4, 0.1], [0.9, 0.7, -0.8]):
        viewpoint = eye.eye_box.at(np.array(unit))
        slope_offset = np.moveaxis(
            solve_pixels(eye, axes, eye.display.panel.grid(20, 20), viewpoint).slope_offset, -1, 0
        )
        place = transforms.rotate(axes.T, raster_position.at(viewpoint) - viewpoint)
        before, after = (np.nanmean(offsets(slope_offset, each)) for each in (np.zeros(3), place))
        print(f"{device}: mean offset {1e3 * before:.3f} mm at the viewpoint, {1e3 * after:.3f} mm at the raster eye")
        assert after < 0.15 * before


def test_the_fit_over_the_eye_box_is_the_nearest_point_itself() -> None:
    eye = traced("northstar")
    axes = middle_axes(eye)
    raster_position, rng = RasterPosition(eye, axes), np.random.default_rng(2)
    for viewpoint in eye.eye_box.at(rng.uniform(-1, 1, (4, 3))):
        slope_offset = solve_pixels(eye, axes, eye.display.panel.grid(20, 20), viewpoint).slope_offset
        nearest = viewpoint + axes @ nearest_point_to_rays(np.moveaxis(slope_offset, -1, 0))
        np.testing.assert_allclose(raster_position.at(viewpoint), nearest, atol=5e-6)


def test_it_never_jumps_and_stays_with_the_eye_outside_the_box(toy_headset: Eye) -> None:
    raster_position, box = RasterPosition(toy_headset, np.eye(3)), toy_headset.eye_box
    outwards = box.at(np.linspace(0, 3, 301)[:, None] * [1, 0.5, -1])
    step = np.diff(raster_position.at(outwards), axis=0)
    np.testing.assert_allclose(step, np.diff(outwards, axis=0), atol=2e-6)
    far = box.centre + [1.0, -2.0, 3.0]
    assert np.linalg.norm(raster_position.at(far) - far) < 0.005


@pytest.mark.parametrize("lead", [(), (1,), (3, 1, 2)])
def test_viewpoints_have_any_leading_axes(toy_headset: Eye, lead: tuple[int, ...]) -> None:
    raster_position, rng = RasterPosition(toy_headset, np.eye(3)), np.random.default_rng(3)
    viewpoint = toy_headset.eye_box.at(rng.uniform(-1, 1, (*lead, 3)))
    place = raster_position.at(viewpoint)
    assert place.shape == (*lead, 3)
    for index in np.ndindex(lead):
        np.testing.assert_allclose(place[index], raster_position.at(viewpoint[index]), atol=1e-15)


CAMERA = Pinhole(300, 200, np.array([-0.6, -0.4]), np.array([0.6, 0.4]))
PANEL = Panel(100, 80)


def bend_of(matrix: ArrayLike, warp_grid: WarpGrid, size_px: tuple[int, int]) -> Float32Array:
    """Rays whose place at infinity is `matrix` times the pixel of a picture of this size."""
    pixel = warp_grid.panel_pixel() * size_px / PANEL.size_px
    tangents = CAMERA.tangents_of_pixel(pixel @ np.asarray(matrix).T + [20.0, 10.0])
    return np.concatenate([tangents, 0 * tangents], axis=-1).transpose(2, 0, 1).astype(np.float32)


@pytest.mark.parametrize("size_px", [(100, 80), (50, 40), (200, 80)])
@pytest.mark.parametrize("matrix", [[[1.3, 0], [0, 0.9]], [[0.2, 0.7], [-1.1, 0.3]]])
@pytest.mark.parametrize("warp_grid", [WarpGrid.of_pixels(PANEL), WarpGrid.edge_to_edge(PANEL, 13, 7)])
def test_the_shrink_of_an_affine_map_is_its_largest_singular_value(
    matrix: Sequence[list[float]], warp_grid: WarpGrid, size_px: tuple[int, int]
) -> None:
    expected = np.linalg.svd(matrix, compute_uv=False)[0]
    assert largest_minification(bend_of(matrix, warp_grid, size_px), warp_grid, CAMERA, size_px) == pytest.approx(
        expected, 1e-4
    )


def test_the_place_where_the_map_shrinks_most_counts_and_holes_do_not() -> None:
    warp_grid = WarpGrid.of_pixels(PANEL)
    slope_offset = bend_of(np.eye(2), warp_grid, (100, 80))
    slope_offset[0, :, 60:] += 0.8 / CAMERA.focal_px[0] * np.arange(40)
    slope_offset[:, 10:20, 10:20] = np.nan
    assert largest_minification(slope_offset, warp_grid, CAMERA, (100, 80)) == pytest.approx(1.8, 1e-3)


def test_without_solved_rays_there_is_no_minification() -> None:
    warp_grid = WarpGrid.of_pixels(PANEL)
    assert largest_minification(np.full((4, 80, 100), np.nan, np.float32), warp_grid, CAMERA, (100, 80)) == 0.0
    assert samples_for(0.0) == 1


def test_samples_per_axis_leave_no_gap() -> None:
    minification = np.linspace(0.1, MAX_SAMPLES * SPACING_PX, 200)
    samples_per_axis = np.array([samples_for(x) for x in minification])
    assert (minification / samples_per_axis <= SPACING_PX + 1e-9).all()
    assert (samples_per_axis[minification <= SPACING_PX] == 1).all()
    assert (np.diff(samples_per_axis) >= 0).all()
    assert samples_for(100.0) == MAX_SAMPLES
