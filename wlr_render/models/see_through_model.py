"""See-through model: deviation from the straight ray as a function of the viewpoint's place and the view direction.

At the place c and the view tangents t, the ray in the world passes through c + B(c, t) and has tangents t + A(c, t);
without optics, A = B = 0. The place of a planar model is the point p~ of the base plane where the ray of t crosses it;
for other models it is the viewpoint. B is an offset at constant z, on a tilted plane too, so that a point P seen along
t gives (P_xy - c_xy) / Z - t = A + B / Z with Z = c_z - P_z: linear in A and B. In terms of the paper's two planes
P_real+ and P_real- at depths Z+ and Z- in front of an untilted base plane, its p_real+- are p~ + Z+- t + (B + Z+- A):
the same two unknown 2-vectors, so both parametrisations span the same models for fronto-parallel planes (section 3.4).
Here the real points need not lie in two such planes.

The forward query is in closed form. The unknowns of the backward query are the view tangents at the viewpoint, so that
the solve does not degenerate for a viewpoint in the plane.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from wlr_render.geometry.planes import BasePlane
from wlr_render.mappings import EyeBox
from wlr_render.models.contraction import NEAREST_POINT_M, grid_over, largest_norm, viewpoints_of
from wlr_render.models.fitted_model import Answer, FittedSeeThrough, Sensitivity, joined
from wlr_render.models.inverse import solve_warm_then_cold
from wlr_render.models.model_place import NOWHERE, ModelPlace
from wlr_render.models.spread import Covariance
from wlr_render.numerics.arrays import FloatArray, IntArray
from wlr_render.numerics.newton import Root
from wlr_render.numerics.polynomial import Box, Polynomial, total_degree

_LEVELS = [3, 3, 5, 13, 13]  # grid of viewpoints and tangents over which the contraction is taken, from edge to edge


@dataclass(frozen=True)
class SeeThroughModel(FittedSeeThrough):
    """A fitted `SeeThroughMapping`.

    The view tangents (..., 2) are the warm start of the backward query.

    Attributes:
        eye_box: box of valid viewpoints; it affects the status only.
        place: base plane of the fit, or the coordinates of the viewpoint that the polynomial depends on.
        deviation: (place m, tx, ty) -> (Ax, Ay, Bx m, By m).
        spread: covariance of `deviation`.
    """

    eye_box: EyeBox
    place: ModelPlace
    deviation: Polynomial
    spread: Covariance | None = None

    MODELLED: ClassVar[str] = "deviation"

    def contraction(self) -> float:
        """Return the largest norm of the derivative of t -> straight - (apparent displacement of the point at t).

        Real points are `NEAREST_POINT_M` away or farther. The displacement is linear in the point's inverse depth, so
        its two ends suffice; directions and viewpoints are taken on a grid.
        """
        viewpoints, directions = viewpoints_of(self.eye_box), self.deviation.box.select((-2, -1))
        both = Box(np.append(viewpoints.low, directions.low), np.append(viewpoints.high, directions.high))
        viewpoint, tangents = np.hsplit(grid_over(both, _LEVELS), [3])
        inside = self.deviation.box.contains(self._inputs(tangents, viewpoint))
        ends = (np.full(np.count_nonzero(inside), inverse) for inverse in (0.0, 1.0 / NEAREST_POINT_M))
        return max(largest_norm(self.displacement_at(tangents[inside], viewpoint[inside], end)[1]) for end in ends)

    def solve_tangents(self, point: FloatArray, viewpoint: FloatArray, start: FloatArray | None) -> Root:
        """Solve for the view tangents whose world rays pass through real points (n, 3) in front of viewpoints (n, 3).

        The residual is the ray's lateral miss over the depth of the point in front of the eye: t - straight +
        displacement. `start` are earlier solutions (n, 2); a cold start is the straight line.
        """
        inverse_depth = 1.0 / (viewpoint[:, 2] - point[:, 2])
        straight = (point[:, :2] - viewpoint[:, :2]) * inverse_depth[:, None]

        def residual(tangents: FloatArray, index: IntArray) -> tuple[FloatArray, FloatArray]:
            bent, slope = self.displacement_at(tangents, viewpoint[index], inverse_depth[index])
            return tangents - straight[index] + bent, np.eye(2) + slope

        return solve_warm_then_cold(residual, start, straight, self.deviation.rounding)

    def displacement_at(
        self, tangents: FloatArray, viewpoint: FloatArray, inverse_depth: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return the apparent displacement of points at inverse depths (m,) in front of viewpoints (m, 3), 1/m.

        With s the depth at which B is defined and w the inverse depth, zero at infinity, it is (1 - s w) A + w B.

        Returns:
            The displacement (m, 2) at view tangents (m, 2), and its total derivative (m, 2, 2) by them: the place moves
            with the tangents.
        """
        depth, places = self.place.depth_along(viewpoint, tangents), self.place.coordinates
        value, jacobian = self.deviation.with_jacobian(self._inputs(tangents, viewpoint))
        by_tangents = jacobian[..., places:] + jacobian[..., :places] @ self.place.carry_by_tangents(depth, tangents)
        by_depth = value[:, :2, None] * self.place.depth_by_tangents(depth, tangents)[:, None, :]
        near = inverse_depth[:, None]
        far = 1.0 - depth[:, None] * near  # share of the point's depth behind B
        slope = far[..., None] * by_tangents[:, :2] + near[..., None] * (by_tangents[:, 2:] - by_depth)
        return far * value[:, :2] + near * value[:, 2:], slope

    def _inputs(self, tangents: FloatArray, viewpoint: FloatArray) -> FloatArray:
        return joined(self.place.carry(viewpoint, tangents), tangents)

    def _forward(self, tangents: FloatArray, viewpoint: FloatArray, _: FloatArray | None) -> Answer:
        inputs = self._inputs(tangents, viewpoint)
        value = self.deviation(inputs)
        origin = self.place.lift(inputs[:, :2]) if isinstance(self.place, BasePlane) else viewpoint
        ray = joined(origin[:, :2] + value[:, 2:], origin[:, 2:], tangents + value[:, :2])
        return Answer(ray, self.deviation.box.contains(inputs))

    def _backward(self, point: FloatArray, viewpoint: FloatArray, start: FloatArray | None) -> Answer:
        root = self.solve_tangents(point, viewpoint, start)
        inside = self.deviation.box.contains(self._inputs(root.unknown, viewpoint))
        return Answer(root.unknown, inside, root.converged, root.unknown)

    def _sensitivity(self, subject: FloatArray, viewpoint: FloatArray, tangents: FloatArray) -> Sensitivity:
        near = 1.0 / (viewpoint[:, 2] - subject[:, 2])
        far = 1.0 - self.place.depth_along(viewpoint, tangents) * near
        slope = np.eye(2) + self.displacement_at(tangents, viewpoint, near)[1]
        by_value = np.concatenate([each[:, None, None] * np.eye(2) for each in (far, near)], axis=-1)
        return Sensitivity(self._inputs(tangents, viewpoint), np.asarray(-np.linalg.solve(slope, by_value)))


def undeviated(eye_box: EyeBox) -> SeeThroughModel:
    """Return the see-through mapping without optics: straight rays, for the baseline that ignores the combiner."""
    everywhere = Box(np.full(2, -10.0), np.full(2, 10.0))
    return SeeThroughModel(eye_box, NOWHERE, Polynomial(total_degree(2, 0), everywhere, np.zeros((1, 4))))
