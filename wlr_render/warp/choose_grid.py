"""Choice of a warp grid, or of a mesh's grid: the coarsest with a measured interpolation error within a tolerance.

`WarpGrid.interpolated` neglects the third derivatives of a smooth ray map: the error grows at least with the cube of
the cell size. The triangles of a mesh neglect the second derivatives: the error grows with the square.
"""

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from wlr_render.geometry.directions import ARCMIN, arcmin_between, dir_of_tangents
from wlr_render.mappings import Eye, Panel
from wlr_render.numerics.arrays import FloatArray
from wlr_render.warp.grid import WarpGrid
from wlr_render.warp.ray_map import NEAREST_M, RayMap, RayMapPlan, choose_plan, ray_map, solve_pixels

TOLERANCE_ARCMIN = 0.02
"""Default tolerance: a tenth of the misalignment allowed for the composed frame, a hundredth when squared; invisible
with float32 and display pixels of 1 to 3 arcmin."""

_MOST_CELLS = 256
_JUDGED_PIXELS = 60
_BLOCK_PX = 4
_MOST_SNAPPED = 0.2
_LEAST_CHANGE = 0.9
_NODES_TOLERANCE_PX = 0.0005


@dataclass(frozen=True, eq=False)
class _Search:
    order: int  # power of the cell size with which the error grows
    places: FloatArray  # positions in a cell with the largest error
    cells: int  # number of cells that are judged along each axis
    units: FloatArray  # viewpoints that are judged, see `EyeBox.at`
    coarsest_cells: int
    aim: float  # share of the tolerance that the next grid aims at
    close: float  # expected growth of a cell from which on a grid within the tolerance is made coarser


_CORNERS = np.array([[0, 0, 0], *itertools.product((-1, 1), repeat=3)], dtype=np.float64)
# Cubics in one coordinate have their largest errors at these places, mixed cubics on the diagonal.
_OF_CUBICS = np.array([[0.21, 0.21], [0.79, 0.21], [0.5, 0.5], [0.21, 0.79], [0.79, 0.79]])
_QUADRATIC = _Search(3, _OF_CUBICS, 10, _CORNERS, coarsest_cells=16, aim=0.95, close=np.inf)
# The errors of triangles are largest inside and at the middles of their sides; the diagonal is the longest side.
_OF_SQUARES = np.array([[0, 3], [3, 0], [3, 3], [3, 6], [6, 3], [2, 2], [4, 4]]) / 6
_LINEAR = _Search(2, _OF_SQUARES, 24, _CORNERS[[0, 8, 2, 3, 5]], coarsest_cells=8, aim=0.85, close=1.1)


@dataclass(frozen=True, eq=False)
class ChosenWarpGrid:
    """A warp grid and its measured interpolation error.

    Attributes:
        grid: the warp grid.
        bound_arcmin: the largest error found, see `warp_grid_error_arcmin`; infinite if no ray was found anywhere.
        hole_share: 0..1, the share of the test points that lie in a hole or in a cell next to one; no error is computed
            there.
    """

    grid: WarpGrid
    bound_arcmin: float
    hole_share: float

    @property
    def cell_px(self) -> FloatArray:
        """(2,) panel pixels between neighbouring points."""
        return self.grid.step_px


def choose_warp_grid(
    mappings: Eye,
    device_from_camera: FloatArray,
    tolerance_arcmin: float = TOLERANCE_ARCMIN,
) -> ChosenWarpGrid:
    """Return the coarsest warp grid of nearly square cells whose error is within the tolerance over the eye box.

    The error is judged at the centre and corners of the eye box. There are at most 256 cells along an axis: if that is
    not fine enough, `bound_arcmin` exceeds the tolerance. Cells are whole blocks of 4 x 4 px where such a size divides
    the panel and is not much smaller than necessary: GPUs and software renderers shade pixels in blocks, and blocks on
    the border of two triangles twice.

    Args:
        mappings: any display and see-through mappings.
        device_from_camera: (3, 3) axes of the rays.
        tolerance_arcmin: tolerance, see `warp_grid_error_arcmin`.
    """
    panel = mappings.display.panel

    def judged(cell_px: float) -> ChosenWarpGrid:
        columns, rows = (max(_cells_along(int(size), cell_px) + 1, 3) for size in panel.size_px)
        grid = WarpGrid.edge_to_edge(panel, columns, rows)
        return _judged(mappings, grid, _QUADRATIC, partial(warp_grid_error_arcmin, mappings, device_from_camera, grid))

    return _coarsest(judged, _QUADRATIC, panel, float(np.max(panel.size_px)) / _MOST_CELLS, tolerance_arcmin)


def choose_mesh_grid(mappings: Eye, axes: FloatArray, size_px: tuple[int, int], tolerance_arcmin: float) -> WarpGrid:
    """Return the coarsest grid of square cells whose triangles are within the tolerance; no finer than the picture."""
    panel, nodes = mappings.display.panel, _node_count(mappings)

    def judged(cell_px: float) -> ChosenWarpGrid:
        columns, rows = (np.ceil(panel.size_px / cell_px).astype(int) + 1).tolist()
        plan = RayMapPlan.onto_grid(WarpGrid.edge_to_edge(panel, columns, rows), nodes, axes)
        return _judged_mesh(mappings, plan, partial(ray_map, mappings, plan=plan))

    return _coarsest(judged, _LINEAR, panel, float(np.min(panel.size_px / size_px)), tolerance_arcmin).grid


def _coarsest(
    judged: Callable[[float], ChosenWarpGrid], kind: _Search, panel: Panel, finest_px: float, tolerance: float
) -> ChosenWarpGrid:
    """Return the coarsest grid within the tolerance, the finest if all exceed it, the first if no ray is known."""
    coarsest_px = max(float(np.min(panel.size_px)) / kind.coarsest_cells, finest_px)
    cell_px, finer = coarsest_px, None
    while True:
        chosen = judged(cell_px)
        is_within = chosen.bound_arcmin <= tolerance
        if finer is not None:  # the cells were enlarged again
            return chosen if is_within else finer
        change = (kind.aim * tolerance / max(chosen.bound_arcmin, 1e-9)) ** (1 / kind.order)
        aimed_px = float(
            np.clip(cell_px * (change if is_within else min(_LEAST_CHANGE, change)), finest_px, coarsest_px)
        )
        if np.isinf(chosen.bound_arcmin) or aimed_px == cell_px or (is_within and aimed_px < kind.close * cell_px):
            return chosen
        cell_px, finer = aimed_px, chosen if is_within else None


def mesh_plan(mappings: Eye, axes: FloatArray, grid: WarpGrid) -> RayMapPlan:
    """Return the plan of a mesh's ray maps, with enough nodes that the triangles limit the accuracy."""
    return RayMapPlan.onto_grid(grid, _node_count(mappings), axes)


def _node_count(mappings: Eye) -> int:
    return choose_plan(mappings, _NODES_TOLERANCE_PX).node_count


def mesh_error_arcmin(mappings: Eye, plan: RayMapPlan, ray_map_at: Callable[[FloatArray], RayMap]) -> float:
    """Return the largest error of rays between the vertices, in cells all over the panel and the eye box.

    The error is relative to the exact solve, see `ray_error_arcmin`; infinite if no ray is found anywhere.
    """
    return _judged_mesh(mappings, plan, ray_map_at).bound_arcmin


def _judged_mesh(mappings: Eye, plan: RayMapPlan, ray_map_at: Callable[[FloatArray], RayMap]) -> ChosenWarpGrid:
    def error_at(viewpoint: FloatArray, pixel: FloatArray) -> FloatArray:
        rays = np.asarray(ray_map_at(viewpoint).slope_offset, np.float64)
        exact = solve_pixels(mappings, plan.device_from_camera, pixel, viewpoint).slope_offset
        return ray_error_arcmin(plan.warp_grid.interpolated(rays, pixel, bends=False), exact)

    return _judged(mappings, plan.warp_grid, _LINEAR, error_at)


def _cells_along(size_px: int, most_px: float) -> int:
    """Return the number of equal cells of at most `most_px` along an axis."""
    whole_blocks = [
        cell
        for cell in range(_BLOCK_PX, int(most_px) + 1, _BLOCK_PX)
        if size_px % cell == 0 and cell >= (1 - _MOST_SNAPPED) * most_px
    ]
    return size_px // whole_blocks[-1] if whole_blocks else int(np.ceil(size_px / most_px))


def _judged(
    mappings: Eye, grid: WarpGrid, kind: _Search, error_at: Callable[[FloatArray, FloatArray], FloatArray]
) -> ChosenWarpGrid:
    """Judge a grid in cells out to the panel's corners, and at fixed pseudo-random pixels."""
    along = [np.unique(np.linspace(0, count - 2, kind.cells).round()) for count in grid.size]
    cells = np.stack(np.meshgrid(*along), axis=-1).reshape(-1, 1, 2)
    in_cells = grid.first_px + grid.step_px * (cells + kind.places).reshape(-1, 2)
    elsewhere = np.random.default_rng(20250102).uniform(0.5, grid.panel.size_px - 0.5, (_JUDGED_PIXELS, 2))
    pixel = np.concatenate([in_cells, elsewhere])
    error = np.stack([error_at(mappings.eye_box.at(unit), pixel) for unit in kind.units])
    known = np.isfinite(error)
    bound = float(error[known].max()) if known.any() else np.inf
    return ChosenWarpGrid(grid, bound, 1.0 - float(known.mean()))


def warp_grid_error_arcmin(
    mappings: Eye,
    device_from_camera: FloatArray,
    warp_grid: WarpGrid,
    viewpoint: FloatArray,
    pixel: FloatArray,
) -> FloatArray:
    """Return the error of `WarpGrid.interpolated` between exact rays, relative to the exact solve.

    Args:
        mappings: any display and see-through mappings.
        device_from_camera: (3, 3) axes of the rays.
        warp_grid: the warp grid to be judged.
        viewpoint: (3,) device frame.
        pixel: (n, 2) panel positions.

    Returns:
        (n,) arcminutes, see `ray_error_arcmin`; NaN where a ray for the comparison is missing, and in cells next to a
        hole.
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
    """Return the error (...) of rays (..., 4): the angle at infinity plus the offset's angle at the nearest depth."""
    angle = arcmin_between(dir_of_tangents(slope_offset[..., :2]), dir_of_tangents(exact[..., :2]))
    return np.asarray(angle + np.linalg.norm(slope_offset[..., 2:] - exact[..., 2:], axis=-1) / NEAREST_M / ARCMIN)
