"""The smooth map from lattice coordinates to pixels around each dot: where it should be, how large a cell is there, and
how far the picture of a disc is centred beside the picture of the disc's centre.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

_NEIGHBOURS = 24  # a 5 x 5 window without its middle
_STIFFNESS = 1e-3  # keeps second and third orders finite where a fragment is too narrow to show them


@dataclass(frozen=True, eq=False)
class LatticeShape:
    """Smooth maps around n dots.

    Attributes:
        expected: (n, 2) pixel where the neighbours, without the dot itself, say that the dot is.
        slope: (n, 2, 2) pixels (rows) per lattice unit (columns).
        curvature: (n, 2, 2, 2) second derivatives: of pixel, by lattice unit, by lattice unit.
        neighbour: (n, k) which dots were used.
    """

    expected: FloatArray
    slope: FloatArray
    curvature: FloatArray
    neighbour: IntArray

    @property
    def cell_px2(self) -> FloatArray:
        """(n,) area of a lattice cell in the picture."""
        return np.asarray(np.abs(np.linalg.det(self.slope)))

    def centroid_shift(self, radius: FloatArray) -> FloatArray:
        """(n, 2) centre of area of a disc's picture less the picture of its centre, pixels.

        With f the map, J its slope and the disc's second moments radius^2 / 4 per axis: the integral of f |J| over the
        integral of |J|, to second order. For a plane seen in perspective it is what J. Heikkila, "Geometric camera
        calibration using circular control points", PAMI 22 (2000) 1066, corrects; lenses and optics are in it too.

        Args:
            radius: (n,) of the discs, lattice units.
        """
        growth = np.einsum("nlc,nckl->nk", np.linalg.inv(self.slope), self.curvature)  # of ln |J|
        mean_lift = 0.5 * np.einsum("nckk->nc", self.curvature)
        return np.asarray(0.25 * radius[:, None] ** 2 * (mean_lift + np.einsum("nck,nk->nc", self.slope, growth)))


def lattice_shape(index: IntArray, pixel: FloatArray) -> LatticeShape:
    """Fit the maps.

    Args:
        index: (n, 2) lattice coordinates, n >= 7, not all in one line.
        pixel: (n, 2) where they are seen.
    """
    near = cKDTree(index).query(index, min(_NEIGHBOURS + 1, len(index)))[1]
    step = (index[near] - index[:, None, :]).astype(np.float64)
    to_near = pixel[near] - pixel[:, None, :]
    quadratic = _fit(step[:, 1:], to_near[:, 1:], 2)
    # At the edge of a fragment all neighbours lie on one side: without third orders, theirs would pass for curvature.
    cubic = _fit(step, to_near, 3)
    slope = np.stack([cubic[:, 1], cubic[:, 2]], axis=-1)
    across = np.stack([cubic[:, 3], cubic[:, 4]], axis=-1)
    curvature = np.stack([across, np.stack([cubic[:, 4], cubic[:, 5]], axis=-1)], axis=-1)
    return LatticeShape(pixel + quadratic[:, 0], slope, curvature, near[:, 1:])


def _fit(step: FloatArray, seen: FloatArray, order: int) -> FloatArray:
    """Least squares (n, terms, 2) of `seen` (n, k, 2): 1, x, y, x^2 / 2, x y, y^2 / 2, x^3 / 6, ..., y^3 / 6."""
    powers = [(total - j, j) for total in range(order + 1) for j in range(total + 1)]
    x, y = step[..., 0], step[..., 1]
    basis = np.stack([x**i * y**j / (math.factorial(i) * math.factorial(j)) for i, j in powers], axis=-1)
    held = np.diag([_STIFFNESS if i + j > 1 else 0.0 for i, j in powers])
    transposed = np.swapaxes(basis, 1, 2)
    return np.asarray(np.linalg.solve(transposed @ basis + held, transposed @ seen))
