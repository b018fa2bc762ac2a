"""Solves that all fitted models share, and where a backward solve starts.

The forward polynomials are the model. A backward query is their inverse, found by Newton's method, so that forward and
backward agree to the tolerance of the solve. Only its start is fitted or sampled.
"""

from dataclasses import dataclass

import numpy as np

from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.newton import Residual, Root, solve_2x2
from wlr_render.numerics.polynomial import Box, Polynomial, basis, total_degree
from wlr_render.numerics.regressor import Regressor

TOLERANCE = 1e-12
"""Tolerance of the residual: metres for a point in the base plane, tangents otherwise."""

_START_DEGREE = 3
_LEVELS = 7, 4  # samples per pixel axis and per axis of the place


def solve_warm_then_cold(residual: Residual, start: FloatArray | None, cold: FloatArray, rounding: float = 0.0) -> Root:
    """Solve from `start` (n, 2), and once more from `cold` (n, 2) where that fails; None starts cold.

    The residual may be as large as its `rounding`.
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


@dataclass(frozen=True)
class Deviation:
    """A see-through model at m pairs of viewpoint and view tangents t.

    Attributes:
        value: (m, 4) A, then B: the world ray has tangents t + A and is offset by B from the straight ray at `depth`.
        by_tangents: (m, 4, 2) the total derivative of `value` by t at a fixed viewpoint.
        depth: (m,) depth s in front of the viewpoint at which B is defined, metres.
        depth_by_tangents: (m, 2).
    """

    value: FloatArray
    by_tangents: FloatArray
    depth: FloatArray
    depth_by_tangents: FloatArray

    def seen_at(self, inverse_depth: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the apparent displacement of a point, tangents (m, 2), and its derivative by t, (m, 2, 2).

        Args:
            inverse_depth: (m,) inverse depth of the point in front of the viewpoint, 1/m; zero is infinity.
        """
        near = inverse_depth[:, None]
        far = 1.0 - self.depth[:, None] * near  # share of the point's depth behind B
        value = far * self.value[:, :2] + near * self.value[:, 2:]
        by_depth = self.value[:, :2, None] * self.depth_by_tangents[:, None, :]
        slope = far[..., None] * self.by_tangents[:, :2] + near[..., None] * (self.by_tangents[:, 2:] - by_depth)
        return value, slope

    def view_by_value(self, inverse_depth: FloatArray) -> FloatArray:
        """Return the derivative (m, 2, 4) of the view tangents of points at `inverse_depth` (m,) by (A, B)."""
        near = inverse_depth[:, None, None]
        by_value = np.concatenate([(1.0 - self.depth[:, None, None] * near) * np.eye(2), near * np.eye(2)], axis=-1)
        return np.asarray(-np.linalg.solve(np.eye(2) + self.seen_at(inverse_depth)[1], by_value))


def backward_start_of(forward: Regressor) -> Polynomial:
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
