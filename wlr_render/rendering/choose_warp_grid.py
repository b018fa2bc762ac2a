"""Choice of the warp grid: the coarsest whose measured interpolation error is within a tolerance.

Between four points the reading of a smooth ray map errs most at the middle of the cell, by an eighth of the second
differences there: with the square of the cell's size. What a GPU's coarse filter weights add (`gl.read_between_texels`)
is not in the bound.
"""

from dataclasses import dataclass

import numpy as np

from wlr_render.geometry.directions import ARCMIN, arcmin_between, dir_of_tangents
from wlr_render.mappings import EyeMappings
from wlr_render.numerics.arrays import FloatArray
from wlr_render.rendering.ray_map import NEAREST_M, solve_pixels
from wlr_render.rendering.warp_grid import WarpGrid

TOLERANCE_ARCMIN = 0.02
"""A tenth of the misalignment that the composed frame may have, so that squared it is a hundredth; below what float32
and a display pixel of 1 to 3 arcmin let anyone see."""

_COARSEST_CELLS = 8
_JUDGED_CELLS = 10
_JUDGED_PIXELS = 60
_JUDGED_VIEWPOINTS = np.array([[0, 0, 0], [1, 1, 1], [-1, -1, 1], [-1, 1, -1], [1, -1, -1]], dtype=np.float64)
_CORNERS = np.array([[0, 0], [1, 0], [0, 1], [1, 1]])
_AIM = 0.95


@dataclass(frozen=True, eq=False)
class ChosenWarpGrid:
    """A warp grid and its measured interpolation error.

    Attributes:
        grid: the points.
        bound_arcmin: the largest error found, as `warp_grid_error_arcmin`; no more than rounding if the points are the
            picture's pixels; infinite if no ray was found anywhere.
        hole_share: 0..1, the share of the judged places where a ray is missing, exact or read, and no error known.
    """

    grid: WarpGrid
    bound_arcmin: float
    hole_share: float

    @property
    def cell_px(self) -> FloatArray:
        """(2,) panel pixels from one point to the next."""
        return self.grid.step_px


def choose_warp_grid(
    mappings: EyeMappings,
    device_from_camera: FloatArray,
    size_px: tuple[int, int],
    tolerance_arcmin: float = TOLERANCE_ARCMIN,
) -> ChosenWarpGrid:
    """Return the coarsest warp grid of square cells whose error is within the tolerance over the eye box.

    Judged at the eye box's centre and at four of its corners, no two of which share an edge, at `judged_pixels`. Where
    no warp grid coarser than the picture's pixels is within the tolerance, its points are those pixels, whose rays are
    read as they are.

    Args:
        mappings: any pair.
        device_from_camera: (3, 3) axes in which rays are known.
        size_px: (width, height) of the picture that covers the panel.
        tolerance_arcmin: as `warp_grid_error_arcmin`.
    """
    panel = mappings.display.panel
    finest_px = float(np.min(panel.size_px / size_px))
    cell_px = float(np.min(panel.size_px)) / _COARSEST_CELLS
    while cell_px > finest_px:
        columns, rows = (np.ceil(panel.size_px / cell_px).astype(int) + 1).tolist()
        warp_grid = WarpGrid.edge_to_edge(panel, columns, rows)
        chosen = _judged(mappings, device_from_camera, warp_grid, judged_pixels(warp_grid))
        if chosen.bound_arcmin <= tolerance_arcmin:
            return chosen
        cell_px *= min(0.9, float(np.sqrt(_AIM * tolerance_arcmin / chosen.bound_arcmin)))
    pixels = WarpGrid.of_pixels(panel, size_px)
    return _judged(mappings, device_from_camera, pixels, _some_points(pixels))


def _judged(
    mappings: EyeMappings, device_from_camera: FloatArray, warp_grid: WarpGrid, pixel: FloatArray
) -> ChosenWarpGrid:
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
    """Panel positions (n, 2): middles of cells out to the panel's corners, and fixed pseudo-random ones."""
    columns, rows = (np.unique(np.linspace(0, count - 2, _JUDGED_CELLS).round()) + 0.5 for count in warp_grid.size)
    middles = warp_grid.first_px + warp_grid.step_px * np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
    rng = np.random.default_rng(20250102)
    return np.concatenate([middles, rng.uniform(0.5, warp_grid.panel.size_px - 0.5, (_JUDGED_PIXELS, 2))])


def _some_points(warp_grid: WarpGrid) -> FloatArray:
    """Fixed pseudo-random points of the warp grid itself, (n, 2)."""
    return np.random.default_rng(20250102).choice(warp_grid.panel_pixel().reshape(-1, 2), _JUDGED_PIXELS)


def warp_grid_error_arcmin(
    mappings: EyeMappings,
    device_from_camera: FloatArray,
    warp_grid: WarpGrid,
    viewpoint: FloatArray,
    pixel: FloatArray,
) -> FloatArray:
    """Error of bilinear interpolation between a warp grid's exact rays, against the exact solve.

    Args:
        mappings: any pair.
        device_from_camera: (3, 3) axes in which rays are read.
        warp_grid: judged.
        viewpoint: (3,) device frame.
        pixel: (n, 2) panel positions.

    Returns:
        (n,) arcminutes, as `ray_error_arcmin`; NaN where a ray that the comparison needs is missing.
    """
    place = np.clip((pixel - warp_grid.first_px) / warp_grid.step_px, 0, np.array(warp_grid.size) - 1)
    cell = np.minimum(place.astype(int), np.array(warp_grid.size) - 2)
    corner = cell[:, None] + _CORNERS
    weight = np.prod(1.0 - np.abs(place[:, None] - corner), axis=-1)
    asked = np.concatenate([pixel[:, None], warp_grid.first_px + warp_grid.step_px * corner], axis=1)
    slope_offset = solve_pixels(mappings, device_from_camera, asked, viewpoint).slope_offset
    exact, read = slope_offset[:, 0], np.einsum("nc,nck->nk", weight, slope_offset[:, 1:])
    return ray_error_arcmin(read, exact)


def ray_error_arcmin(slope_offset: FloatArray, exact: FloatArray) -> FloatArray:
    """Error of rays (..., 4): the angle at infinity plus the offset's angle at the nearest depth, (...)."""
    angle = arcmin_between(dir_of_tangents(slope_offset[..., :2]), dir_of_tangents(exact[..., :2]))
    return np.asarray(angle + np.linalg.norm(slope_offset[..., 2:] - exact[..., 2:], axis=-1) / NEAREST_M / ARCMIN)
