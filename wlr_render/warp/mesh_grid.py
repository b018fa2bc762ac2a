"""Choice of a warp mesh's triangles: the coarsest grid whose measured interpolation error is within a tolerance."""

from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray

from wlr_render.mappings import Eye
from wlr_render.numerics.arrays import FloatArray
from wlr_render.warp.choose_grid import ray_error_arcmin
from wlr_render.warp.grid import WarpGrid
from wlr_render.warp.ray_map import RayMap, RayMapPlan, choose_plan, ray_map, solve_pixels

_COARSEST_CELLS = 8
_JUDGED_CELLS = 24
_JUDGED_VIEWPOINTS = np.array([[0, 0, 0], [1, 1, 1], [-1, -1, 1], [-1, 1, -1], [1, -1, -1]], dtype=np.float64)
_NODES_TOLERANCE_PX = 0.0005
_TRIED_GRIDS = 8
_AIM, _CLOSE = 0.85, 1.1
# Vertices of the two triangles of a cell, as (column, row) steps from its upper left point, and where linear
# interpolation errs most: at the middles of the sides, of which the diagonal is the longest, and within.
_TRIANGLES = np.array([[[0, 0], [0, 1], [1, 0]], [[1, 0], [0, 1], [1, 1]]])
_WEIGHTS = np.array([[0, 0.5, 0.5], [0.5, 0.5, 0], [0.5, 0, 0.5], [1 / 3, 1 / 3, 1 / 3]])


def mesh_triangles(grid: WarpGrid) -> NDArray[np.uint32]:
    """Return the two triangles of each cell, (m, 3) indices of a grid's points, row by row; counter-clockwise."""
    column, row = np.meshgrid(np.arange(grid.columns - 1), np.arange(grid.rows - 1))
    corner = np.stack([column, row], axis=-1).reshape(-1, 1, 1, 2) + _TRIANGLES
    return np.asarray((corner[..., 1] * grid.columns + corner[..., 0]).reshape(-1, 3), np.uint32)


def mesh_plan(mappings: Eye, axes: FloatArray, grid: WarpGrid) -> RayMapPlan:
    """Return the plan of a mesh's ray maps, with enough nodes that the triangles limit the accuracy."""
    return RayMapPlan.onto_grid(grid, _node_count(mappings), axes)


def _node_count(mappings: Eye) -> int:
    return choose_plan(mappings, _NODES_TOLERANCE_PX).node_count


def mesh_grid(mappings: Eye, axes: FloatArray, size_px: tuple[int, int], tolerance_arcmin: float) -> WarpGrid:
    """Return the coarsest grid of square cells whose triangles are within the tolerance; no finer than the picture."""
    panel = mappings.display.panel
    finest_px, coarsest_px = float(np.min(panel.size_px / size_px)), float(np.min(panel.size_px)) / _COARSEST_CELLS
    nodes, cell_px = _node_count(mappings), coarsest_px
    chosen: WarpGrid | None = None
    for _ in range(_TRIED_GRIDS):
        columns, rows = (np.ceil(panel.size_px / cell_px).astype(int) + 1).tolist()
        grid = WarpGrid.edge_to_edge(panel, columns, rows)
        plan = RayMapPlan.onto_grid(grid, nodes, axes)
        error = mesh_error_arcmin(mappings, plan, partial(ray_map, mappings, plan=plan))
        chosen = grid if error <= tolerance_arcmin or chosen is None else chosen
        # The error goes with the square of the cell's size.
        aimed_px = float(np.clip(cell_px * np.sqrt(_AIM * tolerance_arcmin / error), finest_px, coarsest_px))
        if aimed_px == cell_px or (error <= tolerance_arcmin and aimed_px < _CLOSE * cell_px):
            return grid
        cell_px = aimed_px
    assert chosen is not None
    return chosen


def mesh_error_arcmin(mappings: Eye, plan: RayMapPlan, ray_map_at: Callable[[FloatArray], RayMap]) -> float:
    """Largest error of rays between the vertices, in cells all over the panel and viewpoints all over the eye box.

    Against the exact solve, as `ray_error_arcmin`; infinite if no ray is found anywhere.
    """
    grid, axes = plan.warp_grid, plan.device_from_camera
    columns, rows = (np.unique(np.linspace(0, count - 2, _JUDGED_CELLS).round()).astype(int) for count in grid.size)
    vertex = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 1, 1, 2) + _TRIANGLES  # (cells, 2, 3, 2)
    pixel = np.einsum("wk,ctkd->ctwd", _WEIGHTS, grid.first_px + grid.step_px * vertex)
    worst = -np.inf
    for unit in _JUDGED_VIEWPOINTS:
        viewpoint = mappings.eye_box.at(unit)
        at_vertices = np.moveaxis(ray_map_at(viewpoint).slope_offset, 0, -1)
        linear = np.einsum("wk,ctkr->ctwr", _WEIGHTS, at_vertices[vertex[..., 1], vertex[..., 0]])
        error = ray_error_arcmin(linear, solve_pixels(mappings, axes, pixel, viewpoint).slope_offset)
        worst = max(worst, float(np.max(error, initial=-np.inf, where=np.isfinite(error))))
    return worst if np.isfinite(worst) else np.inf
