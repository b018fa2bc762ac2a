"""Smooth maps from lattice coordinates to pixels around each feature of a board, and centres of discs from these maps.

A map predicts the position of a feature, the size of a lattice cell there, and the offset between the centre of area of
a disc's image and the image of the disc's centre: the squared radius of the disc times the curvature of the map. The
detection estimates the map from the neighbours of a dot. If dots are far apart in the picture, the lens distortion from
dot to dot exceeds third-order maps, and centres are wrong by tenths of a pixel. Once the lens is known, only the map
from the board to the lens has to be fitted to the neighbours (`Discs`).
"""

import math
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from wlr_render.geometry.directions import normalised
from wlr_render.lenses.lens import Lens
from wlr_render.numerics.arrays import FloatArray, IntArray

_NEIGHBOURS = 24  # number of neighbours: a 5 x 5 window without the middle
_POWERS = [(total - j, j) for total in range(4) for j in range(total + 1)]  # powers of x and y: 1, x, y, x^2, x y, ...
_STIFFNESS = 1e-3  # ridge of second and third orders, for fragments too narrow to determine them

_LEAST_STIFFNESS = 1e-9  # ridge of first orders; it makes the slope across a single row of dots zero

_OUTLIER_SPREADS = 6.0  # outlier threshold, in typical departures from the lattice
_OUTLIER_CELLS = 0.005  # least outlier threshold, in sides of a cell
_LEAST_CELL = 0.05  # least area of a cell relative to the usual one; a single row of dots has no cells
_STEPS = np.sqrt(0.5) * np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
"""Points with the second moments of the unit disc."""


@dataclass(frozen=True, eq=False)
class LatticeShape:
    """Third-order maps around n features, each fitted to the feature's neighbours without the feature.

    At the edge of a fragment, all neighbours lie on one side, where second-order maps would be biased by third orders.

    Attributes:
        expected: (n, 2) pixels of the dots predicted from their neighbours.
        doubt: (n,) standard deviation per axis of the dot's distance from the prediction, for dots of unit noise.
        slope: (n, 2, 2) pixels (rows) per lattice unit (columns).
        curvature: (n, 2, 2, 2) second derivatives of the pixel (first axis) by lattice units (other axes).
        neighbour: (n, k) numbers of the dots that were used.
    """

    expected: FloatArray
    doubt: FloatArray
    slope: FloatArray
    curvature: FloatArray
    neighbour: IntArray

    @property
    def cell_px2(self) -> FloatArray:
        """Area of a lattice cell in the picture, (n,)."""
        return np.asarray(np.abs(np.linalg.det(self.slope)))

    def centroid_shift(self, radius: FloatArray) -> FloatArray:
        """Return the centre of area of a disc's image minus the image of its centre, (n, 2) pixels.

        The centre is the integral of f |J| over the integral of |J|, to second order, with the map f, its slope J and
        the disc's second moments radius^2 / 4 per axis. For a plane in perspective, the shift is the correction of J.
        Heikkila, "Geometric camera calibration using circular control points", PAMI 22 (2000) 1066; here it includes
        lenses and optics.

        Args:
            radius: (n,) radii of the discs, lattice units.
        """
        growth = np.einsum("nlc,nckl->nk", np.linalg.inv(self.slope), self.curvature)  # gradient of ln |J|
        mean_lift = 0.5 * np.einsum("nckk->nc", self.curvature)
        return np.asarray(0.25 * radius[:, None] ** 2 * (mean_lift + np.einsum("nck,nk->nc", self.slope, growth)))


def lattice_shape(index: FloatArray | IntArray, pixel: FloatArray) -> LatticeShape:
    """Fit a third-order map around each feature.

    Args:
        index: (n, 2) lattice coordinates, n >= 2.
        pixel: (n, 2) pixels of the features.
    """
    near = scipy.spatial.cKDTree(index).query(index, min(_NEIGHBOURS + 1, len(index)))[1][:, 1:]
    x, y = np.moveaxis((index[near] - index[:, None, :]).astype(np.float64), -1, 0)
    basis = np.stack([x**i * y**j / (math.factorial(i) * math.factorial(j)) for i, j in _POWERS], axis=-1)
    held = np.diag([(0.0, _LEAST_STIFFNESS, _STIFFNESS, _STIFFNESS)[i + j] for i, j in _POWERS])
    transposed = np.swapaxes(basis, 1, 2)
    covariance = np.linalg.inv(transposed @ basis + held)
    term = covariance @ (transposed @ (pixel[near] - pixel[:, None, :]))
    slope = np.stack([term[:, 1], term[:, 2]], axis=-1)
    curvature = np.stack([np.stack([term[:, 3], term[:, 4]], -1), np.stack([term[:, 4], term[:, 5]], -1)], -1)
    return LatticeShape(pixel + term[:, 0], np.sqrt(1.0 + covariance[:, 0, 0]), slope, curvature, near)


def smooth_rows(index: FloatArray | IntArray, pixel: FloatArray, least: int) -> tuple[IntArray, LatticeShape | None]:
    """Return the features that agree with their neighbours, and their maps; the worst are rejected first.

    Args:
        index: (n, 2) lattice coordinates.
        pixel: (n, 2) pixels of the features.
        least: fewest features; if fewer are left, the maps are None.
    """
    rows = np.arange(len(index))
    while len(rows) >= least:
        shape = lattice_shape(index[rows], pixel[rows])
        off = np.linalg.norm(pixel[rows] - shape.expected, axis=-1) / shape.doubt
        most = np.maximum(_OUTLIER_SPREADS * float(np.median(off)), _OUTLIER_CELLS * np.sqrt(shape.cell_px2))
        # An outlier makes its neighbours look like outliers too, so that only the worst of a neighbourhood is rejected.
        keep = (off <= most) | (off < off[shape.neighbour].max(axis=1))
        keep &= shape.cell_px2 > _LEAST_CELL * float(np.median(shape.cell_px2))
        if keep.all():
            return rows, shape
        rows = rows[keep]
    return rows, None


@dataclass(frozen=True, eq=False)
class Discs:
    """Round features in a photograph.

    Attributes:
        centroid: (n, 2) centres of area of their images, camera pixels.
        radius_m: (n,) radii on the board.
    """

    centroid: FloatArray
    radius_m: FloatArray

    def only(self, rows: NDArray[np.generic]) -> "Discs":
        """Return the discs selected by a mask (n,) or by numbers."""
        return Discs(self.centroid[rows], self.radius_m[rows])

    def centres(self, lens: Lens, point: FloatArray, pixel: FloatArray) -> FloatArray:
        """Return the pixels (n, 2) of the centres of the discs.

        Args:
            lens: lens of the camera, at least roughly.
            point: (n, 3) positions of the centres on the board, board frame, metres.
            pixel: (n, 2) centres, accurate to a fraction of a pixel; returned where the lens has no direction for them.
        """
        direction = lens.dir_of_pixel(pixel)
        finite = np.isfinite(direction).all(axis=-1)
        if finite.sum() < 2:
            return pixel
        result = pixel.copy()
        shift = _centroid_shift(lens, point[finite, :2], direction[finite], self.radius_m[finite])
        result[finite] = np.where(np.isfinite(shift), self.centroid[finite] - shift, pixel[finite])
        return result


def _centroid_shift(lens: Lens, place: FloatArray, direction: FloatArray, radius: FloatArray) -> FloatArray:
    """Return the centre of area of each disc's image minus the image of its centre, (n, 2) pixels.

    The centre of area is the mean over the disc, weighted by the area of the image.

    Args:
        lens: lens of the camera.
        place: (n, 2) positions on the board.
        direction: (n, 3) directions of the centres, camera frame.
        radius: (n,) radii of the discs, in the units of `place`.
    """
    unit = float(np.median(scipy.spatial.cKDTree(place).query(place, 2)[0][:, 1]))
    to_view = _looking_along(direction.mean(axis=0))
    in_view = direction @ to_view.T
    tangents = in_view[:, :2] / in_view[:, 2:]
    shape = lattice_shape(place / unit, tangents)
    weight, total = np.zeros((len(place), 1)), np.zeros_like(place)
    for step in radius[:, None] / unit * _STEPS[:, None]:
        bend = np.einsum("nckl,nl->nck", shape.curvature, step)
        at = tangents + np.einsum("nck,nk->nc", shape.slope + 0.5 * bend, step)
        projection = lens.project(_forward(at) @ to_view)
        area = np.abs(np.linalg.det(projection.by_point @ to_view[:2].T @ (shape.slope + bend)))[:, None]
        weight += area
        total += area * projection.pixel
    with np.errstate(invalid="ignore"):  # features in one row have no area
        return np.asarray(total / weight - lens.pixel_of_point(_forward(tangents) @ to_view))


def _forward(tangents: FloatArray) -> FloatArray:
    return np.concatenate([tangents, np.ones((len(tangents), 1))], axis=-1)


def _looking_along(direction: FloatArray) -> FloatArray:
    """Return a rotation (3, 3) that turns a direction into z."""
    z = normalised(direction)
    x = normalised(np.cross(np.eye(3)[np.argmin(np.abs(z))], z))
    return np.stack([x, np.cross(z, x), z])
