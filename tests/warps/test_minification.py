from collections.abc import Sequence

import numpy as np
import pytest
from numpy.typing import ArrayLike

from wlr_render.geometry.pinhole import Pinhole
from wlr_render.mappings import Panel
from wlr_render.numerics.arrays import Float32Array
from wlr_render.warp.grid import WarpGrid
from wlr_render.warp.raster_camera import MAX_SAMPLES, largest_minification, samples_for
from wlr_render.warp.warp import SPACING_PX

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
