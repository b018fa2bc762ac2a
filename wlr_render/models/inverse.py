"""Solves that all fitted models share, and where a backward solve starts.

The forward polynomials are the model. A backward query is their inverse, found by Newton's method, so that forward and
backward agree to the tolerance of the solve. Only its start is fitted or sampled.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from wlr_render.numerics.arrays import FloatArray, IntArray
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


def solve_pixel(
    tangents_of: Regressor,
    backward_start: Polynomial,
    place: FloatArray,
    tangents: FloatArray,
    start: FloatArray | None,
) -> Root:
    """Solve for the pixel with the given view tangents.

    Args:
        tangents_of: (u, v, place) -> (tx, ty), the model.
        backward_start: (place, tx, ty) -> (u, v), the cold start.
        place: (n, any) inputs of the model that depend on the viewpoint; fixed during the solve.
        tangents: (n, 2).
        start: (n, 2) earlier pixels, or None.

    Returns:
        Root whose unknown is the pixel, (n, 2).
    """
    tangents_at = tangents_of.held(range(2, 2 + place.shape[1]), place)

    def residual(pixel: FloatArray, index: IntArray) -> tuple[FloatArray, FloatArray]:
        value, jacobian = tangents_at.with_jacobian(pixel, index)
        return value - tangents[index], jacobian

    cold = backward_start(np.concatenate([place, tangents], axis=1))
    return solve_warm_then_cold(residual, start, cold, tangents_of.rounding)


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

    @classmethod
    def at_viewpoint(cls, value: FloatArray, by_tangents: FloatArray) -> "Deviation":
        """Return the deviation of a model whose B is defined at the viewpoint's z."""
        return cls(value, by_tangents, np.zeros(len(value)), np.zeros((len(value), 2)))

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


def solve_view_tangents(
    deviation_at: Callable[[FloatArray, IntArray], Deviation],
    point: FloatArray,
    viewpoint: FloatArray,
    start: FloatArray | None,
    rounding: float = 0.0,
) -> Root:
    """Solve for the view direction whose world ray passes through a real point.

    The residual is the ray's lateral miss over the depth D of the point in front of the eye:
    t - straight + (1 - s / D) A + B / D, with s the depth at which B is defined. The cold start is the straight line.

    Args:
        deviation_at: the model at tangents (m, 2) and the viewpoints with the indices (m,).
        point: (n, 3) in front of the viewpoint.
        viewpoint: (n, 3).
        start: (n, 2) earlier solutions, or None.
        rounding: rounding error of the residual.

    Returns:
        Root whose unknown is t, (n, 2).
    """
    inverse_depth = 1.0 / (viewpoint[:, 2] - point[:, 2])
    straight = (point[:, :2] - viewpoint[:, :2]) * inverse_depth[:, None]

    def residual(tangents: FloatArray, index: IntArray) -> tuple[FloatArray, FloatArray]:
        bent, slope = deviation_at(tangents, index).seen_at(inverse_depth[index])
        return tangents - straight[index] + bent, np.eye(2) + slope

    return solve_warm_then_cold(residual, start, straight, rounding)


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
