"""Sine waves: in one of several variables, or products of them in a box."""

from dataclasses import dataclass

import numpy as np

from wlr_render.numerics.arrays import BoolArray, FloatArray, IntArray
from wlr_render.numerics.polynomial import Box


@dataclass(frozen=True, eq=False)
class Wave:
    """A vector-valued function that is a sine wave in one variable and does not depend on the others.

    Attributes:
        axis: number of the variable.
        period: of the wave, in the variable's unit.
        coefficients: (2, outputs) of the sine and of the cosine of 2 pi x / period.
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
        orders: (terms, variables) from 1.
        box: outside of which the function is zero.
        coefficients: (terms, outputs).
    """

    orders: IntArray
    box: Box
    coefficients: FloatArray

    def __call__(self, inputs: FloatArray) -> FloatArray:
        """Return the values (n, outputs) at inputs (n, variables); zero where these are NaN."""
        value = np.zeros((len(inputs), self.coefficients.shape[1]))
        inside, factors, _ = self._factors(inputs)
        value[inside] = np.prod(factors, axis=2) @ self.coefficients
        return value

    def with_jacobian(self, inputs: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the values (n, outputs) and their derivatives (n, outputs, variables)."""
        count, outputs, variables = len(inputs), self.coefficients.shape[1], inputs.shape[1]
        value, jacobian = np.zeros((count, outputs)), np.zeros((count, outputs, variables))
        inside, factors, slopes = self._factors(inputs)
        value[inside] = np.prod(factors, axis=2) @ self.coefficients
        for axis in range(variables):
            along = np.where(np.arange(variables) == axis, slopes, factors)
            jacobian[inside, :, axis] = np.prod(along, axis=2) @ self.coefficients
        return value, jacobian

    def _factors(self, inputs: FloatArray) -> tuple[BoolArray, FloatArray, FloatArray]:
        """Return which inputs (n,) lie in the box, and their factors (m, terms, variables) with derivatives."""
        across = 0.5 * (self.box.scaled(inputs) + 1.0)
        inside = np.all((across > 0.0) & (across < 1.0), axis=1)
        angle = np.pi * across[inside][:, None, :]
        wave, slope = np.sin(angle * self.orders), self.orders * np.cos(angle * self.orders)
        per_unit = 0.5 * np.pi * self.box.per_unit
        return inside, np.sin(angle) * wave, per_unit * (np.cos(angle) * wave + np.sin(angle) * slope)


def local_orders(most: int) -> IntArray:
    """Return the orders (terms, 2) of local waves in two variables whose sum is at most one above `most`."""
    pairs = [(m, n) for m in range(1, most + 1) for n in range(1, most + 2 - m)]
    return np.array(sorted(pairs, key=sum), dtype=np.int64)
