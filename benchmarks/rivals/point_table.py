"""One point in space per pixel, in a table: Klemm, Seebacher and Hoppe.

P. Klemm, F. Seebacher and L. Hoppe, "Non-parametric camera-based calibration of optical see-through glasses for AR
applications", Cyberworlds 2016, and "High accuracy pixel-wise spatial calibration of optical see-through glasses",
Computers & Graphics 64, 2017. `models.point_per_pixel` with a polynomial over the panel is the smooth version.
"""

from typing import Any

import numpy as np
from scipy.interpolate import RBFInterpolator, RegularGridInterpolator
from scipy.spatial import Delaunay, QhullError

from benchmarks.rivals.map_tables import PositionMaps
from benchmarks.rivals.numeric_regressor import NumericRegressor
from benchmarks.rivals.samples import Samples
from wlr_render.calibration.fit_display import DISPLAY
from wlr_render.calibration.readings import TREND_ALONE, angular_metric
from wlr_render.captures.correspondences import DisplayCaptures
from wlr_render.errors import BadInputError
from wlr_render.geometry.planes import BasePlane
from wlr_render.models.model_place import VIEWPOINT
from wlr_render.models.point_per_pixel import PointPerPixelDisplay
from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.polynomial import basis

_COLUMNS, _ROWS = 25, 21
_SLACK = 0.05  # margin around the decoded region of a position, over its size: about the distance of its pixels
_BASELINE_M = 0.5e-3  # smallest rms distance of a pixel's camera positions from their mean


def klemm_grid(captures: DisplayCaptures, columns: int = _COLUMNS, rows: int = _ROWS) -> PointPerPixelDisplay:
    """Triangulate the point in space of each node of a pixel grid, with bilinear interpolation between the nodes.

    A node's point is the one nearest to its rays from all camera positions. Adapted: each position's map is a
    polynomial that gives the ray of a node, where the paper decodes every pixel; points are stored as tangents and
    inverse depth, so that an image may lie at infinity, and their angles are minimised; nodes that fewer than two
    positions see are extrapolated by thin plates. A see-through counterpart was not published; combine it with a
    static see-through model.

    Args:
        captures: captures from two or more camera positions.
        columns, rows: numbers of nodes of the grid over the decoded part of the panel.

    Raises:
        BadInputError: a camera position has too few readings, or fewer than two camera positions see a pixel.
    """
    plane = BasePlane(float(captures.eye_box.centre[2]))
    readings = DISPLAY.kinds["volumetric"].readings(captures, VIEWPOINT, TREND_ALONE, None)
    viewpoint, position = np.unique(captures.viewpoint, axis=0, return_inverse=True)
    position = position.reshape(-1)
    maps = PositionMaps.of(Samples(readings, position))
    axes = [np.linspace(maps.box.low[axis], maps.box.high[axis], n) for axis, n in enumerate((columns, rows))]
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    tangents = np.einsum("nt,kto->kno", basis(nodes, maps.orders, maps.box), maps.coefficients)
    seen = np.stack([_within(nodes, captures.pixel[position == k]) for k in range(len(viewpoint))])
    centre = captures.eye_box.centre
    crossing = plane.carry(viewpoint[:, None], tangents) - centre[:2]
    points = _points(tangents, crossing, seen)
    known = np.isfinite(points).all(axis=1)
    if known.sum() < 3 or np.linalg.matrix_rank(nodes[known] - nodes[known].mean(axis=0)) < 2:
        raise BadInputError(
            f"two camera positions or more see only {known.sum()} of {len(nodes)} grid nodes of {captures.device}; a "
            "point in space needs two positions, some millimetres apart, that see the same part of the panel."
        )
    if not known.all():
        scaled = maps.box.scaled(nodes)
        points[~known] = RBFInterpolator(scaled[known], points[known], kernel="thin_plate_spline")(scaled[~known])
    table = RegularGridInterpolator(axes, points.reshape(columns, rows, 3), bounds_error=False, fill_value=None)
    point: Any = NumericRegressor(table, maps.box, outputs=3, numbers=points.size)
    return PointPerPixelDisplay(captures.panel, captures.eye_box, point)


def _within(nodes: FloatArray, pixel: FloatArray) -> FloatArray:
    """Return 1 for nodes (n, 2) in the slightly grown hull of pixels (m, 2), else 0: (n,)."""
    centre = 0.5 * (pixel.min(axis=0) + pixel.max(axis=0))
    try:
        hull = Delaunay(pixel)
    except QhullError:  # all pixels are on one line
        return np.zeros(len(nodes))
    return np.asarray(hull.find_simplex(centre + (nodes - centre) / (1.0 + _SLACK)) >= 0, np.float64)


def _points(tangents: FloatArray, crossing: FloatArray, seen: FloatArray) -> FloatArray:
    """Solve t = a - w q by least squares over the positions that see a node: (n, 3) a and w, NaN without a point.

    Args:
        tangents: (k, n, 2) t of the nodes from k positions.
        crossing: (k, n, 2) q, at which the nodes' rays cross the nominal plane.
        seen: (k, n) 1 if a position sees a node, else 0.
    """
    weight = (seen * angular_metric(tangents) ** 2)[..., None]
    total = weight.sum(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        mean, place = ((weight * each).sum(axis=0) / total for each in (tangents, crossing))
        spread = np.sum(weight * (crossing - place) ** 2, axis=(0, 2))
        inverse_depth = -np.sum(weight * (crossing - place) * (tangents - mean), axis=(0, 2)) / spread
        points = np.column_stack([mean + inverse_depth[:, None] * place, inverse_depth])
        known = spread > _BASELINE_M**2 * total[:, 0]
    return np.asarray(np.where(known[:, None], points, np.nan))
