"""Polynomials of total degree N in scaled variables, with their Jacobian.

The basis is products of Chebyshev polynomials T_k of the variables scaled to -1..1: it spans the same space as the
monomials and is well conditioned at degree 7 and above, so that rank checks are reliable.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import comb

import numpy as np
from numpy.typing import NDArray

from wlr_render.numerics.arrays import FloatArray, IntArray

BOX_SLACK = 1e-3
"""By how much of its size a fitted box may be left, so that samples on its border count as inside."""

_CHUNK = 2_048  # rows per block: keeps the basis (rows x terms) in the processor's cache


def term_count(variables: int, degree: int) -> int:
    """Number of terms of total degree up to `degree`: C(variables + degree, degree)."""
    return comb(variables + degree, degree)


@lru_cache(maxsize=64)
def exponents(variables: int, degree: int) -> IntArray:
    """(terms, variables) orders of the Chebyshev factors of each term, ordered by total degree; read-only."""
    rows = [e for e in itertools.product(range(degree + 1), repeat=variables) if sum(e) <= degree]
    rows.sort(key=lambda e: (sum(e), e))
    table = np.array(rows, dtype=np.int64).reshape(-1, variables)
    table.setflags(write=False)
    return table


@dataclass(frozen=True)
class Box:
    """An axis-aligned box of inputs, which are scaled to -1..1 inside.

    Attributes:
        low, high: (variables,) in the inputs' own units.
    """

    low: FloatArray
    high: FloatArray

    @classmethod
    def around(cls, inputs: FloatArray) -> "Box":
        """Bounding box of samples (n, variables); an axis without extent gets a width of one unit."""
        low, high = inputs.min(axis=0), inputs.max(axis=0)
        flat = high - low <= 1e-12 * np.maximum(1.0, np.abs(high))
        return cls(np.where(flat, low - 0.5, low), np.where(flat, high + 0.5, high))

    def scaled(self, inputs: FloatArray) -> FloatArray:
        """Scale inputs (..., variables) to -1..1 inside the box."""
        return np.asarray((2.0 * inputs - self.low - self.high) / (self.high - self.low))

    def contains(self, inputs: FloatArray, slack: float = BOX_SLACK) -> NDArray[np.bool_]:
        """Whether inputs (..., variables) lie in the box grown by `slack` of its size: (...) bool."""
        return np.asarray(np.all(np.abs(self.scaled(inputs)) <= 1.0 + 2.0 * slack, axis=-1))


def _chebyshev_tables(scaled: FloatArray, degree: int, derivative: bool) -> tuple[FloatArray, FloatArray | None]:
    """T_k and dT_k/dx for k = 0..degree, (degree + 1, variables, n) each."""
    x = np.ascontiguousarray(scaled.T)
    t = np.empty((degree + 1, *x.shape))
    t[0] = 1.0
    if degree >= 1:
        t[1] = x
    for k in range(2, degree + 1):
        t[k] = 2.0 * x * t[k - 1] - t[k - 2]
    if not derivative:
        return t, None
    d = np.zeros_like(t)
    if degree >= 1:
        d[1] = 1.0
    for k in range(2, degree + 1):
        d[k] = 2.0 * t[k - 1] + 2.0 * x * d[k - 1] - d[k - 2]
    return t, d


def basis(inputs: FloatArray, degree: int, box: Box) -> FloatArray:
    """Design matrix (n, terms) of samples (n, variables)."""
    orders = exponents(inputs.shape[-1], degree)
    t, _ = _chebyshev_tables(box.scaled(inputs), degree, derivative=False)
    result = t[orders[:, 0], 0]
    for axis in range(1, orders.shape[1]):
        result *= t[orders[:, axis], axis]
    return np.ascontiguousarray(result.T)


@dataclass(frozen=True)
class Polynomial:
    """A vector-valued polynomial of total degree `degree` over `box`.

    Attributes:
        degree: total degree N.
        box: bounds of the fit; it also scales the variables.
        coefficients: (terms, outputs), rows in the order of `exponents`.
    """

    degree: int
    box: Box
    coefficients: FloatArray

    def __call__(self, inputs: FloatArray) -> FloatArray:
        """Values (..., outputs) at inputs (..., variables)."""
        flat = inputs.reshape(-1, inputs.shape[-1])
        result = np.empty((flat.shape[0], self.coefficients.shape[1]))
        for start in range(0, flat.shape[0], _CHUNK):
            rows = slice(start, start + _CHUNK)
            result[rows] = basis(flat[rows], self.degree, self.box) @ self.coefficients
        return result.reshape(*inputs.shape[:-1], result.shape[1])

    def with_jacobian(self, inputs: FloatArray, axes: Sequence[int] | None = None) -> tuple[FloatArray, FloatArray]:
        """Value (..., outputs) and Jacobian (..., outputs, axes) of (..., variables), in the inputs' units.

        Args:
            inputs: (..., variables).
            axes: the variables to differentiate by, or None for all.
        """
        by, outputs = range(inputs.shape[-1]) if axes is None else axes, self.coefficients.shape[1]
        flat = inputs.reshape(-1, inputs.shape[-1])
        value = np.empty((flat.shape[0], outputs))
        jacobian = np.empty((flat.shape[0], outputs, len(by)))
        for start in range(0, flat.shape[0], _CHUNK):
            rows = slice(start, start + _CHUNK)
            value[rows], jacobian[rows] = self._block(flat[rows], by)
        lead = inputs.shape[:-1]
        return value.reshape(*lead, outputs), jacobian.reshape(*lead, outputs, len(by))

    def _block(self, inputs: FloatArray, axes: Sequence[int]) -> tuple[FloatArray, FloatArray]:
        orders = exponents(inputs.shape[1], self.degree)
        t, d = _chebyshev_tables(self.box.scaled(inputs), self.degree, derivative=True)
        assert d is not None
        per_unit = 2.0 / (self.box.high - self.box.low)
        factors = [t[orders[:, axis], axis] for axis in range(orders.shape[1])]
        columns = []
        for axis in axes:
            product = d[orders[:, axis], axis]
            for other, factor in enumerate(factors):
                if other != axis:
                    product *= factor
            columns.append(per_unit[axis] * (product.T @ self.coefficients))
        whole = factors[0]
        for factor in factors[1:]:
            whole = whole * factor
        return whole.T @ self.coefficients, np.stack(columns, axis=-1)
