"""Solvers shared by all fitted models, and the start values of backward solves.

The forward polynomials are the model. A backward query inverts them by Newton's method, so that forward and backward
agree to the tolerance of the solve. Only the start values are fitted or sampled.
"""

import numpy as np

from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.newton import Residual, Root, solve_2x2
from wlr_render.numerics.polynomial import Box, Polynomial, basis, total_degree

TOLERANCE = 1e-12
"""Tolerance of the residual: metres for a point in the base plane, tangents otherwise."""

_START_DEGREE = 3
_LEVELS = 7, 4  # samples per pixel axis and per axis of the place


def solve_warm_then_cold(residual: Residual, start: FloatArray | None, cold: FloatArray, rounding: float = 0.0) -> Root:
    """Solve from `start` (n, 2), and once more from `cold` (n, 2) where that fails; None starts cold.

    A residual of up to its `rounding` counts as solved.
    """
    tolerance = max(TOLERANCE, rounding)
    if start is None:
        return solve_2x2(residual, cold, tolerance)
    warm = solve_2x2(residual, np.where(np.isfinite(start), start, cold), tolerance)
    lost = np.flatnonzero(~warm.converged)
    if lost.size == 0:
        return warm
    again = solve_2x2(lambda unknown, index: residual(unknown, lost[index]), cold[lost], tolerance)
    unknown, converged = warm.unknown.copy(), warm.converged.copy()
    unknown[lost], converged[lost] = again.unknown, again.converged
    return Root(unknown, converged, warm.iterations + again.iterations)


def backward_start_of(forward: Polynomial) -> Polynomial:
    """Fit a low-degree polynomial (place, tx, ty) -> (u, v) near the inverse of a display's (u, v, place) -> (tx, ty).

    The fit is least squares on a grid over the box of `forward`. Backward queries only start from it.
    """
    places = len(forward.box.low) - 2
    levels = [_LEVELS[0]] * 2 + [_LEVELS[1]] * places
    unit = np.stack(np.meshgrid(*(np.linspace(-1.0, 1.0, n) for n in levels)), axis=-1).reshape(-1, 2 + places)
    sample = 0.5 * (forward.box.low + forward.box.high) + 0.5 * unit * (forward.box.high - forward.box.low)
    inputs = np.concatenate([sample[:, 2:], forward(sample)], axis=1)
    box = Box.around(inputs)
    orders = total_degree(2 + places, _START_DEGREE)
    coefficients = np.linalg.lstsq(basis(inputs, orders, box), sample[:, :2], rcond=None)[0]
    return Polynomial(orders, box, np.asarray(coefficients, np.float64))
