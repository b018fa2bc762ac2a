"""Tensor-product Chebyshev interpolation: from a few nodes to every pixel by two matrix products."""

import numpy as np

from wlr_render.numerics.arrays import FloatArray


def nodes(count: int, low: float, high: float) -> FloatArray:
    """Return `count` Chebyshev points of the first kind in low..high, ascending, ends excluded."""
    x = -np.cos((np.arange(count) + 0.5) * np.pi / count)
    return np.asarray(low + 0.5 * (x + 1.0) * (high - low))


def interpolation_matrix(count: int, low: float, high: float, at: FloatArray) -> FloatArray:
    """Return the barycentric matrix (len(at), count) from the nodes to `at` (Berrut & Trefethen 2004)."""
    x = nodes(count, low, high)
    k = np.arange(count)
    weight = (-1.0) ** k * np.sin((k + 0.5) * np.pi / count)
    difference = at[:, None] - x[None, :]
    exact = difference == 0.0
    terms = weight / np.where(exact, 1.0, difference)
    matrix = terms / terms.sum(axis=1, keepdims=True)
    hit = exact.any(axis=1)
    matrix[hit] = exact[hit]
    return np.asarray(matrix)
