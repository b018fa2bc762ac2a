"""Batched Newton's method for two equations in two unknowns, with convergence status."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wlr_render.numerics.arrays import FloatArray

Residual = Callable[[FloatArray, NDArray[np.int64]], tuple[FloatArray, FloatArray]]
"""(unknown (m, 2), index (m,) into the batch) -> residual (m, 2), Jacobian (m, 2, 2)."""


MAX_ITERATIONS = 30


@dataclass(frozen=True)
class Root:
    """Result of `solve_2x2`.

    Attributes:
        unknown: (n, 2) last iterates, whether or not they converged.
        converged: (n,) mask of the converged elements.
        iterations: number of Newton steps of the slowest element.
    """

    unknown: FloatArray
    converged: NDArray[np.bool_]
    iterations: int


def solve_2x2(residual: Residual, start: FloatArray, tolerance: float) -> Root:
    """Solve residual(unknown) = 0 for n independent problems.

    Steps that do not reduce the residual are halved, up to six times, so that divergence is detected. An element
    is converged when the norm of its residual is at most `tolerance`, in the units of the residual.

    Args:
        residual: returns residual and Jacobian of the elements in an index array.
        start: (n, 2) first guess; rows with NaN never converge.
        tolerance: largest norm of the residual.
    """
    unknown = np.array(start, dtype=np.float64)
    index = np.flatnonzero(np.isfinite(unknown).all(axis=1))
    converged = np.zeros(unknown.shape[0], dtype=bool)
    value, jacobian = residual(unknown[index], index)
    size = np.linalg.norm(value, axis=1)
    iterations = 0
    while True:
        done = size <= tolerance
        converged[index[done]] = True
        going = ~done & np.isfinite(size)
        index, value, jacobian, size = index[going], value[going], jacobian[going], size[going]
        if index.size == 0 or iterations == MAX_ITERATIONS:
            return Root(unknown, converged, iterations)
        iterations += 1
        step = _step(jacobian, value)
        unknown[index], value, jacobian, size = _damped(residual, unknown[index], step, index, size)


def _step(jacobian: FloatArray, value: FloatArray) -> FloatArray:
    a, b, c, d = jacobian[:, 0, 0], jacobian[:, 0, 1], jacobian[:, 1, 0], jacobian[:, 1, 1]
    determinant = a * d - b * c
    with np.errstate(divide="ignore", invalid="ignore"):
        x = (d * value[:, 0] - b * value[:, 1]) / determinant
        y = (a * value[:, 1] - c * value[:, 0]) / determinant
    return np.stack([x, y], axis=1)


def _damped(
    residual: Residual, unknown: FloatArray, step: FloatArray, index: NDArray[np.int64], size: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Take the full step; where the residual does not decrease, halve it and keep the last step tried."""
    trial = unknown - step
    value, jacobian = residual(trial, index)
    new_size = np.linalg.norm(value, axis=1)
    fraction = 1.0
    for _ in range(6):
        worse = np.flatnonzero(~(new_size < size))
        if worse.size == 0:
            break
        fraction *= 0.5
        trial[worse] = unknown[worse] - fraction * step[worse]
        value[worse], jacobian[worse] = residual(trial[worse], index[worse])
        new_size[worse] = np.linalg.norm(value[worse], axis=1)
    return trial, value, jacobian, new_size
