"""Piecewise constant functions: one value in each cell of a regular grid."""

from dataclasses import dataclass

import numpy as np

from wlr_render.numerics.arrays import FloatArray, IntArray
from wlr_render.numerics.polynomial import Box


@dataclass(frozen=True, eq=False)
class Cells:
    """A vector-valued function that is constant in each cell of a grid, and zero in cells without a value.

    Attributes:
        size: width of a cell along each variable; cells meet at the origin.
        middles: (c, variables) middles of the cells that have a value.
        coefficients: (c, outputs) values.
    """

    size: float
    middles: FloatArray
    coefficients: FloatArray

    def __call__(self, inputs: FloatArray) -> FloatArray:
        """Return the values (n, outputs) at inputs (n, variables); zero where these are NaN."""
        known = np.isfinite(inputs).all(axis=1)
        cell = cells_of(np.concatenate([self.middles, inputs[known]]), self.size)[1]
        count, value = len(self.middles), np.zeros((len(inputs), self.coefficients.shape[1]))
        table = np.zeros((int(cell.max(initial=-1)) + 1, self.coefficients.shape[1]))
        table[cell[:count]] = self.coefficients
        value[known] = table[cell[count:]]
        return value

    @property
    def box(self) -> Box:
        """Bounds of all cells that have a value."""
        half = 0.5 * self.size
        return Box(self.middles.min(axis=0) - half, self.middles.max(axis=0) + half)

    @property
    def are_distinct(self) -> bool:
        """True if no two middles lie in the same cell."""
        return len(cells_of(self.middles, self.size)[0]) == len(self.middles)


def cells_of(places: FloatArray, size: float) -> tuple[FloatArray, IntArray]:
    """Return the middles (c, variables) of the cells that contain places (n, variables), and each place's cell (n,)."""
    cells, cell = np.unique(np.floor(places / size), axis=0, return_inverse=True)
    return size * (cells + 0.5), cell.reshape(-1)
