"""Methods that are fitted to captures of a display alone, and their dependence on the viewpoint."""

from collections.abc import Callable, Mapping

import numpy as np

from benchmarks.rivals.kernels import gaussian_process, kernel_ridge
from benchmarks.rivals.map_tables import PositionMaps
from benchmarks.rivals.numeric_regressor import Regressor
from benchmarks.rivals.pinhole import direct_plane, indica_full
from benchmarks.rivals.plane_and_polynomial import wientapper_display
from benchmarks.rivals.point_table import klemm_grid
from benchmarks.rivals.samples import Fit, Samples, fit_structure
from wlr_render.calibration.fit_display import DISPLAY, fit_display
from wlr_render.captures.correspondences import DisplayCaptures
from wlr_render.errors import BadInputError
from wlr_render.mappings import DisplayMapping
from wlr_render.numerics.arrays import FloatArray

FitDisplay = Callable[[DisplayCaptures], DisplayMapping]

_STRAIGHT = 0.02  # largest distance of a position from the common line, over the distance of the outermost positions


def line_table(samples: Samples) -> Regressor:
    """Fit a map at each position of a line, interpolated and extrapolated linearly along the line.

    Raises:
        BadInputError: the positions do not lie on one line.
    """
    maps = PositionMaps.of(samples)
    centre = maps.place.mean(axis=0)
    _, size, axes = np.linalg.svd(maps.place - centre)
    if len(maps.place) < 2 or (len(size) > 1 and size[1] > _STRAIGHT * size[0]):
        raise BadInputError(
            f"{len(maps.place)} camera positions do not lie on one line; a table along a line needs two or more there."
        )
    along = (maps.place - centre) @ axes[0]
    order = np.argsort(along)
    knots = along[order]

    def weights(place: FloatArray) -> FloatArray:
        wanted = (place - centre) @ axes[0]
        first = np.clip(np.searchsorted(knots, wanted) - 1, 0, len(knots) - 2)
        share = (wanted - knots[first]) / (knots[first + 1] - knots[first])
        found, rows = np.zeros((len(place), len(knots))), np.arange(len(place))
        found[rows, order[first]] = 1.0 - share
        found[rows, order[first + 1]] = share
        return found

    return maps.regressor(weights, maps.coefficients)


def _structured(structure: str, fit: Fit) -> FitDisplay:
    return lambda captures: fit_structure(DISPLAY, captures, structure, fit)[0]


def _ours(kind: str) -> FitDisplay:
    return lambda captures: fit_display(captures, kind).mapping


DISPLAYS: Mapping[str, FitDisplay] = {
    "polynomial by least squares, static": _structured("static", Samples.polynomial),
    "plane (DRC)": direct_plane,
    "INDICA full": indica_full,
    "one point per pixel, grid (Klemm)": klemm_grid,
    "table along a line": _structured("volumetric", line_table),
    "plane and polynomial (Wientapper)": lambda captures: wientapper_display(captures)[0],
    "plane and polynomial, planar": lambda captures: wientapper_display(captures, bundled=True)[0],
    "kernel ridge as published, planar": _structured("planar", kernel_ridge),
    "Gaussian process, planar": _structured("planar", gaussian_process),
    "ours: static": _ours("static"),
    "ours: point-per-pixel": _ours("point-per-pixel"),
    "ours: volumetric": _ours("volumetric"),
    "ours: planar": _ours("planar"),
}
"""Methods by name."""
