"""Choice of the warp grid: the coarsest whose measured interpolation error is within a tolerance.

`WarpGrid.interpolated` misses of a smooth ray map its third derivatives: the error grows with the cube of the cell's
size and more.
"""

import itertools
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from wlr_render.geometry.directions import ARCMIN, arcmin_between, dir_of_tangents
from wlr_render.mappings import Eye
from wlr_render.numerics.arrays import FloatArray
from wlr_render.warp.grid import WarpGrid
from wlr_render.warp.ray_map import NEAREST_M, solve_pixels

TOLERANCE_ARCMIN = 0.02
"""A tenth of the misalignment that the composed frame may have, so that squared it is a hundredth; below what float32
and a display pixel of 1 to 3 arcmin let anyone see."""

_COARSEST_CELLS = 16
_MOST_CELLS = 256
_JUDGED_CELLS = 10
_JUDGED_PIXELS = 60
_JUDGED_PLACES = np.array([[0.21, 0.21], [0.79, 0.21], [0.5, 0.5], [0.21, 0.79], [0.79, 0.79]])
"""Positions in a cell with the largest error: of cubics in one coordinate, and on the diagonal of mixed cubics."""
_JUDGED_VIEWPOINTS = np.array([[0, 0, 0], *itertools.product((-1, 1), repeat=3)], dtype=np.float64)
_AIM = 0.95
_BLOCK_PX = 4
_MOST_SNAPPED = 0.2


@dataclass(frozen=True, eq=False)
class ChosenWarpGrid:
    """A warp grid and its measured interpolation error.

    Attributes:
        grid: the points.
        bound_arcmin: the largest error found, as `warp_grid_error_arcmin`; infinite if no ray was found anywhere.
        hole_share: 0..1, the share of the test points that lie in a hole or in a cell next to one; no error is computed
            there.
    """

    grid: WarpGrid
    bound_arcmin: float
    hole_share: float

    @property
    def cell_px(self) -> FloatArray:
        """(2,) panel pixels from one point to the next."""
        return self.grid.step_px


def choose_warp_grid(
    mappings: Eye,
    device_from_camera: FloatArray,
    tolerance_arcmin: float = TOLERANCE_ARCMIN,
) -> ChosenWarpGrid:
    """Return the coarsest warp grid of nearly square cells whose error is within the tolerance over the eye box.

    Judged at the eye box's centre and at its corners, at `judged_pixels`. There are at most 256 cells along an axis:
    where that is not fine enough, `bound_arcmin` exceeds the tolerance. Cells are whole blocks of 4 x 4 px where such a
    size divides the panel and is not much smaller than necessary: GPUs and software renderers shade pixels in blocks,
    and those on the border of two triangles twice.

    Args:
        mappings: any pair.
        device_from_camera: (3, 3) axes in which rays are known.
        tolerance_arcmin: as `warp_grid_error_arcmin`.
    """
    panel = mappings.display.panel
    finest_px = float(np.max(panel.size_px)) / _MOST_CELLS
    cell_px = max(float(np.min(panel.size_px)) / _COARSEST_CELLS, finest_px)
    while True:
        columns, rows = (max(_cells_along(int(size), cell_px) + 1, 3) for size in panel.size_px)
        warp_grid = WarpGrid.edge_to_edge(panel, columns, rows)
        chosen = _judged(mappings, device_from_camera, warp_grid)
        if chosen.bound_arcmin <= tolerance_arcmin or cell_px <= finest_px or chosen.hole_share == 1:
            return chosen
        cell_px = max(finest_px, cell_px * min(0.9, float(np.cbrt(_AIM * tolerance_arcmin / chosen.bound_arcmin))))


def _cells_along(size_px: int, most_px: float) -> int:
    """Return the number of equal cells of at most that size along an axis."""
    whole_blocks = [
        cell
        for cell in range(_BLOCK_PX, int(most_px) + 1, _BLOCK_PX)
        if size_px % cell == 0 and cell >= (1 - _MOST_SNAPPED) * most_px
    ]
    return size_px // whole_blocks[-1] if whole_blocks else int(np.ceil(size_px / most_px))


def _judged(mappings: Eye, device_from_camera: FloatArray, warp_grid: WarpGrid) -> ChosenWarpGrid:
    pixel = judged_pixels(warp_grid)
    error = np.stack(
        [
            warp_grid_error_arcmin(mappings, device_from_camera, warp_grid, mappings.eye_box.at(unit), pixel)
            for unit in _JUDGED_VIEWPOINTS
        ]
    )
    known = np.isfinite(error)
    bound = float(error[known].max()) if known.any() else np.inf
    return ChosenWarpGrid(warp_grid, bound, 1.0 - float(known.mean()))


def judged_pixels(warp_grid: WarpGrid) -> FloatArray:
    """Panel positions (n, 2): in cells out to the panel's corners, and fixed pseudo-random ones."""
    along = [np.unique(np.linspace(0, count - 2, _JUDGED_CELLS).round()) for count in warp_grid.size]
    cells = np.stack(np.meshgrid(*along), axis=-1).reshape(-1, 1, 2)
    in_cells = warp_grid.first_px + warp_grid.step_px * (cells + _JUDGED_PLACES).reshape(-1, 2)
    rng = np.random.default_rng(20250102)
    return np.concatenate([in_cells, rng.uniform(0.5, warp_grid.panel.size_px - 0.5, (_JUDGED_PIXELS, 2))])


def warp_grid_error_arcmin(
    mappings: Eye,
    device_from_camera: FloatArray,
    warp_grid: WarpGrid,
    viewpoint: FloatArray,
    pixel: FloatArray,
) -> FloatArray:
    """Error of `WarpGrid.interpolated` between a warp grid's exact rays, against the exact solve.

    Args:
        mappings: any pair.
        device_from_camera: (3, 3) axes in which rays are read.
        warp_grid: judged.
        viewpoint: (3,) device frame.
        pixel: (n, 2) panel positions.

    Returns:
        (n,) arcminutes, as `ray_error_arcmin`; NaN where a ray that the comparison needs is missing, and in the cells
        next to a hole.
    """
    at_points = solve_pixels(mappings, device_from_camera, warp_grid.panel_pixel(), viewpoint).slope_offset
    exact = solve_pixels(mappings, device_from_camera, pixel, viewpoint).slope_offset
    error = ray_error_arcmin(warp_grid.interpolated(np.moveaxis(at_points, -1, 0), pixel), exact)
    return np.where(_beside_hole(warp_grid, at_points, pixel), np.nan, error)


def _beside_hole(warp_grid: WarpGrid, at_points: FloatArray, pixel: FloatArray) -> NDArray[np.bool_]:
    """Return which pixels (n, 2) lie next to a missing ray, where second differences are partial."""
    missing = np.isnan(at_points).any(axis=-1)
    around = cv2.dilate(missing.astype(np.uint8), np.ones((3, 3), np.uint8))
    column, row = np.minimum((pixel - warp_grid.first_px) / warp_grid.step_px, np.array(warp_grid.size) - 2).T.astype(
        int
    )
    corners = [around[row + down, column + right] for down in (0, 1) for right in (0, 1)]
    return np.asarray(np.any(corners, axis=0))


def ray_error_arcmin(slope_offset: FloatArray, exact: FloatArray) -> FloatArray:
    """Error of rays (..., 4): the angle at infinity plus the offset's angle at the nearest depth, (...)."""
    angle = arcmin_between(dir_of_tangents(slope_offset[..., :2]), dir_of_tangents(exact[..., :2]))
    return np.asarray(angle + np.linalg.norm(slope_offset[..., 2:] - exact[..., 2:], axis=-1) / NEAREST_M / ARCMIN)
