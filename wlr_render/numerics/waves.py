"""Sine waves: in one of several variables, or products of them in a box."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from wlr_render.numerics.arrays import FloatArray, IntArray
from wlr_render.numerics.polynomial import Box


@dataclass(frozen=True, eq=False)
class Wave:
    """A vector-valued function that is a sine wave in one variable and does not depend on the others.

    Attributes:
        axis: number of the variable.
        period: period of the wave, in the variable's unit.
        coefficients: (2, outputs) coefficients of the sine and of the cosine of 2 pi x / period.
    """

    axis: int
    period: float
    coefficients: FloatArray

    def __call__(self, inputs: FloatArray) -> FloatArray:
        """Return the values (n, outputs) at inputs (n, variables)."""
        return self.with_jacobian(inputs)[0]

    def with_jacobian(self, inputs: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the values (n, outputs) and their derivatives (n, outputs, variables)."""
        per_unit = 2.0 * np.pi / self.period
        sine, cosine = np.sin(per_unit * inputs[:, self.axis]), np.cos(per_unit * inputs[:, self.axis])
        jacobian = np.zeros((len(inputs), self.coefficients.shape[1], inputs.shape[1]))
        jacobian[:, :, self.axis] = per_unit * np.stack([cosine, -sine], axis=1) @ self.coefficients
        return np.stack([sine, cosine], axis=1) @ self.coefficients, jacobian


@dataclass(frozen=True, eq=False)
class LocalWaves:
    """A vector-valued function that is zero, with its slopes, at the edge of a box and outside.

    A term is a product of sin(pi s) sin(k pi s) over the variables, s from 0 to 1 across the box, with an order k each.

    Attributes:
        orders: (terms, variables) orders, from 1.
        box: box outside of which the function is zero.
        coefficients: (terms, outputs).
    """

    orders: IntArray
    box: Box
    coefficients: FloatArray

    def __call__(self, inputs: FloatArray) -> FloatArray:
        """Return the values (n, outputs) at inputs (n, variables); zero where these are NaN."""
        return self.with_jacobian(inputs)[0]

    def with_jacobian(self, inputs: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the values (n, outputs) and their derivatives (n, outputs, variables)."""
        count, outputs, variables = len(inputs), self.coefficients.shape[1], inputs.shape[1]
        value, jacobian = np.zeros((count, outputs)), np.zeros((count, outputs, variables))
        across = 0.5 * (self.box.scaled(inputs) + 1.0)
        inside = np.all((across > 0.0) & (across < 1.0), axis=1)
        factors, slopes = self._factors(np.pi * across[inside])
        value[inside] = self._sum(factors)
        for axis in range(variables):
            jacobian[inside, :, axis] = self._sum([*factors[:axis], slopes[axis], *factors[axis + 1 :]])
        return value, jacobian

    @cached_property
    def _grid(self) -> FloatArray:
        """Coefficients (orders, ..., outputs) arranged by the order along each variable."""
        most, variables = int(self.orders.max()), self.orders.shape[1]
        grid = np.zeros((*(most,) * variables, self.coefficients.shape[1]))
        np.add.at(grid, tuple(self.orders.T - 1), self.coefficients)
        return grid

    def _factors(self, angle: FloatArray) -> tuple[list[FloatArray], list[FloatArray]]:
        """Return the factors (m, orders) of each variable at angles (m, variables) from 0 to pi, and derivatives."""
        each, per_unit = np.arange(1, len(self._grid) + 1), 0.5 * np.pi * self.box.per_unit
        factors, slopes = [], []
        for along, scale in zip(angle.T[:, :, None], per_unit, strict=True):
            wave, envelope = np.sin(along * each), np.sin(along)
            factors.append(envelope * wave)
            slopes.append(scale * (np.cos(along) * wave + envelope * each * np.cos(along * each)))
        return factors, slopes

    def _sum(self, factors: list[FloatArray]) -> FloatArray:
        """Return the sum (m, outputs) of all terms."""
        count, orders = factors[0].shape
        total = factors[0] @ self._grid.reshape(orders, -1)
        for factor in factors[1:]:
            total = np.einsum("mk,mkr->mr", factor, total.reshape(count, orders, total.shape[1] // orders))
        return np.asarray(total)


def local_orders(most: int) -> IntArray:
    """Return the orders (terms, 2) of local waves in two variables, with sums up to `most` + 1."""
    pairs = [(m, n) for m in range(1, most + 1) for n in range(1, most + 2 - m)]
    return np.array(sorted(pairs, key=sum), dtype=np.int64)
