"""How coarse a lattice may be for its bilinear reading to stay within a tolerance of the exact solve, by measurement.

Between four points the reading of a smooth field errs most at the middle of the cell, by an eighth of the second
differences there: with the square of the cell's size. What a GPU's coarse filter weights add (`gl.read_between_texels`)
is not in the bound.
"""

from dataclasses import dataclass

import numpy as np

from wlr_render.geometry.directions import ARCMIN, arcmin_between, dir_of_tangents
from wlr_render.mappings import EyeMappings
from wlr_render.numerics.arrays import FloatArray
from wlr_render.rendering.ray_map import NEAREST_M, solve_pixels
from wlr_render.rendering.warp_grid import Lattice

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
class ChosenLattice:
    """A lattice and what it costs in exactness.

    Attributes:
        lattice: the points.
        bound_arcmin: the largest error found, as `lattice_error_arcmin`; no more than rounding if the points are the
            picture's pixels; infinite if no ray was found anywhere.
        hole_share: 0..1, the share of the judged places where a ray is missing, exact or read, and no error known.
    """

    lattice: Lattice
    bound_arcmin: float
    hole_share: float

    @property
    def cell_px(self) -> FloatArray:
        """(2,) panel pixels from one point to the next."""
        return self.lattice.step_px


def choose_lattice(
    mappings: EyeMappings,
    device_from_camera: FloatArray,
    size_px: tuple[int, int],
    tolerance_arcmin: float = TOLERANCE_ARCMIN,
) -> ChosenLattice:
    """The coarsest lattice of square cells whose reading is within the tolerance, over the eye box.

    Judged at the eye box's centre and at four of its corners, no two of which share an edge, at `judged_pixels`. Where
    no lattice coarser than the picture's pixels is within the tolerance, its points are those pixels, whose rays are
    read as they are.

    Args:
        mappings: any pair.
        device_from_camera: (3, 3) axes in which the field is known.
        size_px: (width, height) of the picture that covers the panel.
        tolerance_arcmin: as `lattice_error_arcmin`.
    """
    panel = mappings.display.panel
    finest_px = float(np.min(panel.size_px / size_px))
    cell_px = float(np.min(panel.size_px)) / _COARSEST_CELLS
    while cell_px > finest_px:
        columns, rows = (np.ceil(panel.size_px / cell_px).astype(int) + 1).tolist()
        lattice = Lattice.edge_to_edge(panel, columns, rows)
        chosen = _judged(mappings, device_from_camera, lattice, judged_pixels(lattice))
        if chosen.bound_arcmin <= tolerance_arcmin:
            return chosen
        cell_px *= min(0.9, float(np.sqrt(_AIM * tolerance_arcmin / chosen.bound_arcmin)))
    pixels = Lattice.of_pixels(panel, size_px)
    return _judged(mappings, device_from_camera, pixels, _some_points(pixels))


def _judged(
    mappings: EyeMappings, device_from_camera: FloatArray, lattice: Lattice, pixel: FloatArray
) -> ChosenLattice:
    error = np.stack(
        [
            lattice_error_arcmin(mappings, device_from_camera, lattice, mappings.eye_box.at(unit), pixel)
            for unit in _JUDGED_VIEWPOINTS
        ]
    )
    known = np.isfinite(error)
    bound = float(error[known].max()) if known.any() else np.inf
    return ChosenLattice(lattice, bound, 1.0 - float(known.mean()))


def judged_pixels(lattice: Lattice) -> FloatArray:
    """Panel positions (n, 2): middles of cells out to the panel's corners, and fixed pseudo-random ones."""
    columns, rows = (np.unique(np.linspace(0, count - 2, _JUDGED_CELLS).round()) + 0.5 for count in lattice.size)
    middles = lattice.first_px + lattice.step_px * np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
    rng = np.random.default_rng(20250102)
    return np.concatenate([middles, rng.uniform(0.5, lattice.panel.size_px - 0.5, (_JUDGED_PIXELS, 2))])


def _some_points(lattice: Lattice) -> FloatArray:
    """Fixed pseudo-random points of the lattice itself, (n, 2)."""
    return np.random.default_rng(20250102).choice(lattice.panel_pixel().reshape(-1, 2), _JUDGED_PIXELS)


def lattice_error_arcmin(
    mappings: EyeMappings,
    device_from_camera: FloatArray,
    lattice: Lattice,
    viewpoint: FloatArray,
    pixel: FloatArray,
) -> FloatArray:
    """Error of the rays read bilinearly between exact ones at a lattice's points, against the exact solve.

    Args:
        mappings: any pair.
        device_from_camera: (3, 3) axes in which the field is read.
        lattice: judged.
        viewpoint: (3,) device frame.
        pixel: (n, 2) panel positions.

    Returns:
        (n,) arcminutes, as `bend_error_arcmin`; NaN where a ray that the comparison needs is missing.
    """
    place = np.clip((pixel - lattice.first_px) / lattice.step_px, 0, np.array(lattice.size) - 1)
    cell = np.minimum(place.astype(int), np.array(lattice.size) - 2)
    corner = cell[:, None] + _CORNERS
    weight = np.prod(1.0 - np.abs(place[:, None] - corner), axis=-1)
    asked = np.concatenate([pixel[:, None], lattice.first_px + lattice.step_px * corner], axis=1)
    bend = solve_pixels(mappings, device_from_camera, asked, viewpoint).bend
    exact, read = bend[:, 0], np.einsum("nc,nck->nk", weight, bend[:, 1:])
    return bend_error_arcmin(read, exact)


def bend_error_arcmin(bend: FloatArray, exact: FloatArray) -> FloatArray:
    """How far rays (..., 4) are off: the angle at infinity plus the offset's angle at the nearest depth, (...)."""
    angle = arcmin_between(dir_of_tangents(bend[..., :2]), dir_of_tangents(exact[..., :2]))
    return np.asarray(angle + np.linalg.norm(bend[..., 2:] - exact[..., 2:], axis=-1) / NEAREST_M / ARCMIN)
