"""See-through model: deviation from the straight ray as a function of the viewpoint's place and the view direction.

At the place c and the view tangents t, the ray in the world passes through c + B(c, t) and has tangents t + A(c, t); no
optics is A = B = 0. The place of a planar model is the point p~ of the base plane where the ray of t crosses it, that
of the others the viewpoint. B is an offset at constant z, on a tilted plane too, so that a point P seen along t gives
(P_xy - c_xy) / Z - t = A + B / Z with Z = c_z - P_z: linear in A and B. In terms of the paper's two planes P_real+ and
P_real- at depths Z+ and Z- in front of an untilted base plane, its p_real+- are p~ + Z+- t + (B + Z+- A): the same two
unknown 2-vectors, so both parametrisations span the same models for fronto-parallel planes (section 3.4). This one does
not need the real points to lie in two such planes.

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
from wlr_render.models.inverse import Deviation, solve_warm_then_cold
from wlr_render.models.model_place import NOWHERE, ModelPlace
from wlr_render.models.spread import Covariance
from wlr_render.numerics.arrays import FloatArray, IntArray
from wlr_render.numerics.newton import Root
from wlr_render.numerics.polynomial import Box, Polynomial, total_degree
from wlr_render.numerics.regressor import Regressor

_LEVELS = [3, 3, 5, 13, 13]  # grid of viewpoints and tangents over which the contraction is taken, from edge to edge


@dataclass(frozen=True)
class SeeThroughModel(FittedSeeThrough):
    """A fitted `SeeThroughMapping`.

    The view tangents (..., 2) are the warm start of the backward query.

    Attributes:
        eye_box: box of valid viewpoints; it affects the status only.
        place: base plane of the fit, or which coordinates of the viewpoint the polynomial depends on.
        deviation: (place m, tx, ty) -> (Ax, Ay, Bx m, By m).
        spread: covariance of `deviation`.
    """

    eye_box: EyeBox
    place: ModelPlace
    deviation: Regressor
    spread: Covariance | None = None

    MODELLED: ClassVar[str] = "deviation"

    def contraction(self) -> float:
        """Largest norm of the derivative of t -> straight - (apparent displacement of the point at t).

        Real points are `NEAREST_POINT_M` away or farther. The displacement is linear in the point's inverse depth, so
        its two ends suffice; directions and viewpoints are taken on a grid.
        """
        viewpoints, directions = viewpoints_of(self.eye_box), self.deviation.box.select((-2, -1))
        both = Box(np.append(viewpoints.low, directions.low), np.append(viewpoints.high, directions.high))
        viewpoint, tangents = np.hsplit(grid_over(both, _LEVELS), [3])
        inside = self.deviation.box.contains(self._inputs(tangents, viewpoint))
        deviation = self._deviation_at(tangents[inside], viewpoint[inside])
        ends = (np.full(len(deviation.depth), inverse) for inverse in (0.0, 1.0 / NEAREST_POINT_M))
        return max(largest_norm(deviation.seen_at(inverse)[1]) for inverse in ends)

    def solve_tangents(self, point: FloatArray, viewpoint: FloatArray, start: FloatArray | None) -> Root:
        """Solve for the view tangents whose world rays pass through real points (n, 3) in front of viewpoints (n, 3).

        The residual is the ray's lateral miss over the depth D of the point in front of the eye:
        t - straight + (1 - s / D) A + B / D, with s the depth at which B is defined. `start` are earlier solutions
        (n, 2); a cold start is the straight line.
        """
        inverse_depth = 1.0 / (viewpoint[:, 2] - point[:, 2])
        straight = (point[:, :2] - viewpoint[:, :2]) * inverse_depth[:, None]

        def residual(tangents: FloatArray, index: IntArray) -> tuple[FloatArray, FloatArray]:
            bent, slope = self._deviation_at(tangents, viewpoint[index]).seen_at(inverse_depth[index])
            return tangents - straight[index] + bent, np.eye(2) + slope

        return solve_warm_then_cold(residual, start, straight, self.deviation.rounding)

    def _inputs(self, tangents: FloatArray, viewpoint: FloatArray) -> FloatArray:
        return joined(self.place.carry(viewpoint, tangents), tangents)

    def _deviation_at(self, tangents: FloatArray, viewpoint: FloatArray) -> Deviation:
        """Return the deviation at view tangents (m, 2) of viewpoints (m, 3); the place moves with the tangents."""
        depth, places = self.place.depth_along(viewpoint, tangents), self.place.coordinates
        value, jacobian = self.deviation.with_jacobian(self._inputs(tangents, viewpoint))
        by_tangents = jacobian[..., places:] + jacobian[..., :places] @ self.place.carry_by_tangents(depth, tangents)
        return Deviation(value, by_tangents, depth, self.place.depth_by_tangents(depth, tangents))

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
        by_value = self._deviation_at(tangents, viewpoint).view_by_value(1.0 / (viewpoint[:, 2] - subject[:, 2]))
        return Sensitivity(self._inputs(tangents, viewpoint), by_value)


def undeviated(eye_box: EyeBox) -> SeeThroughModel:
    """Return the see-through mapping without optics: straight rays, for the baseline that ignores the combiner."""
    everywhere = Box(np.full(2, -10.0), np.full(2, 10.0))
    return SeeThroughModel(eye_box, NOWHERE, Polynomial(total_degree(2, 0), everywhere, np.zeros((1, 4))))
