"""Tensor-product Chebyshev interpolation: a smooth field from few nodes to every pixel by two matrix products."""

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


def nodes(count: int, low: float, high: float) -> FloatArray:
    """`count` Chebyshev points of the first kind in low..high, ascending; they never touch the ends."""
    x = -np.cos((np.arange(count) + 0.5) * np.pi / count)
    return np.asarray(low + 0.5 * (x + 1.0) * (high - low))


def interpolation_matrix(count: int, low: float, high: float, at: FloatArray) -> FloatArray:
    """(len(at), count): values at the nodes -> values at `at`, by barycentric weights (Berrut & Trefethen 2004)."""
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


def tail(values: FloatArray) -> FloatArray:
    """How much of a field is left in its highest-order coefficients: an estimate of the interpolation error.

    Args:
        values: (rows, columns, outputs) at the tensor nodes.

    Returns:
        (outputs,) sum of the absolute Chebyshev coefficients whose row or column order is among the last two.
    """
    spectrum = values
    for axis in (0, 1):
        count = values.shape[axis]
        k = np.arange(count)
        cosine = np.cos(np.outer(k, (k + 0.5) * np.pi / count)) * (2.0 / count)
        cosine[0] *= 0.5
        # The nodes ascend, so odd orders change sign; only magnitudes are used here.
        spectrum = np.moveaxis(np.tensordot(cosine, spectrum, axes=(1, axis)), 0, axis)
    magnitude = np.abs(spectrum)
    magnitude[:-2, :-2] = 0.0
    return np.asarray(magnitude.sum(axis=(0, 1)))
