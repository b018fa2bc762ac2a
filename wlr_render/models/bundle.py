"""Planar (bundle) models of display and see-through: polynomials in the position on a base plane and the direction.

A viewpoint elsewhere is projected onto the base plane along its ray. Where the view direction is given (display
backward, see-through forward) the projection is `BasePlane.carry`, a closed form. Otherwise it is a 2 x 2 root-find,
for the point on the base plane (display forward) or for the view tangents (see-through backward). It takes about four
Newton steps from a cold start and fewer from the last frame's solution (paper: sections 3.3 and 3.4).

The paper takes the ray, with t >= 0, that passes nearest to the viewpoint (equation 8). Here the plane may lie on
either side of the viewpoint, and where no ray passes through it, the status is NOT_CONVERGED. `contraction.py` refuses
models whose root may not be the only one.

See-through: at the base-plane point p~ and the view tangents t, the ray in the world passes through the point
(p~ + B(p~, t), z of the plane at p~) and has tangents t + A(p~, t); no optics is A = B = 0. B is an offset at constant
z, on a tilted plane too, so that a point P seen along t gives (P_xy - p~) / Z - t = A + B / Z with Z = z(p~) - P_z:
linear in A and B. In terms of the paper's two planes P_real+ and P_real- at depths Z+ and Z- in front of an untilted
base plane, its p_real+- are p~ + Z+- t + (B + Z+- A): the same two unknown 2-vectors, so both parametrisations span the
same models for fronto-parallel planes. This one does not need the real points to lie in two such planes.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from wlr_render.geometry.planes import BasePlane
from wlr_render.mappings import EyeBox, Panel
from wlr_render.models.contraction import display_contraction, see_through_contraction
from wlr_render.models.fitted_model import (
    Answer,
    FittedDisplay,
    FittedSeeThrough,
    Forms,
    Sensitivity,
    joined,
    pixel_answer,
)
from wlr_render.models.inverse import Deviation, solve_view_tangents, solve_warm_then_cold
from wlr_render.models.spread import Covariance
from wlr_render.numerics.arrays import BoolArray, FloatArray, IntArray
from wlr_render.numerics.newton import Root
from wlr_render.numerics.polynomial import Box, Polynomial
from wlr_render.numerics.regressor import Regressor


def solve_display(
    tangents_of: Regressor, plane: BasePlane, pixel: FloatArray, viewpoint: FloatArray, start: FloatArray | None
) -> Root:
    """Solve for the point on the base plane of the ray from a pixel to a viewpoint.

    Solves p~ = carry(viewpoint, t(pixel, p~)). Cold start: the viewpoint's x and y.

    Args:
        tangents_of: (u, v, x, y) -> (tx, ty), fitted on the plane.
        plane: the base plane.
        pixel: (n, 2).
        viewpoint: (n, 3).
        start: (n, 2) earlier solutions, or None.

    Returns:
        Root whose unknown is p~, (n, 2) metres.
    """
    tangents_at = tangents_of.held((0, 1), pixel)

    def residual(point: FloatArray, index: IntArray) -> tuple[FloatArray, FloatArray]:
        tangents, jacobian = tangents_at.with_jacobian(point, index)
        depth = plane.depth_along(viewpoint[index], tangents)
        carried = viewpoint[index, :2] + depth[:, None] * tangents
        return point - carried, np.eye(2) - plane.carry_by_tangents(depth, tangents) @ jacobian

    return solve_warm_then_cold(residual, start, viewpoint[:, :2], tangents_of.rounding)


def solve_see_through(
    deviation: Regressor, plane: BasePlane, point: FloatArray, viewpoint: FloatArray, start: FloatArray | None
) -> Root:
    """Solve for the view direction of a real point; see `inverse.solve_view_tangents`.

    The unknowns are the view tangents t at the viewpoint, so the solve does not degenerate for a viewpoint in the
    plane.

    Args:
        deviation: (x, y, tx, ty) -> (A, B), see the module's docstring.
        plane: the base plane.
        point: (n, 3) in front of the viewpoint.
        viewpoint: (n, 3).
        start: (n, 2) earlier solutions, or None.

    Returns:
        Root whose unknown is t, (n, 2).
    """

    def deviation_at(tangents: FloatArray, index: IntArray) -> Deviation:
        return _deviation_at(deviation, plane, tangents, viewpoint[index])

    return solve_view_tangents(deviation_at, point, viewpoint, start, deviation.rounding)


def _deviation_at(deviation: Regressor, plane: BasePlane, tangents: FloatArray, viewpoint: FloatArray) -> Deviation:
    """Return the deviation at view tangents (m, 2) of viewpoints (m, 3); p~ moves with the tangents."""
    depth = plane.depth_along(viewpoint, tangents)
    in_plane = viewpoint[:, :2] + depth[:, None] * tangents
    value, jacobian = deviation.with_jacobian(joined(in_plane, tangents))
    by_tangents = jacobian[..., 2:] + jacobian[..., :2] @ plane.carry_by_tangents(depth, tangents)
    return Deviation(value, by_tangents, depth, plane.depth_by_tangents(depth, tangents))


@dataclass(frozen=True)
class BundleDisplay(FittedDisplay):
    """A `DisplayMapping` fitted on viewpoints in a plane and projected to all others.

    Viewpoints on the same ray of a pixel see it in the same direction, by construction.

    Both queries are iterative. The warm start is p~ (..., 2) for the forward query, the pixel for the backward query.

    Attributes:
        panel: the panel.
        eye_box: box of valid viewpoints.
        base_plane: the plane of the fit.
        forward: (u px, v px, x m, y m) -> (tx, ty).
        backward_start: (x m, y m, tx, ty) -> (u px, v px), where backward queries start.
        spread: covariance of `forward`.
    """

    panel: Panel
    eye_box: EyeBox
    base_plane: BasePlane
    forward: Regressor
    backward_start: Polynomial
    spread: Covariance | None = None

    FORMS: ClassVar[Forms] = {"forward": (4, 2), "backward_start": (4, 2)}

    def contraction(self) -> float:
        """Contraction of the forward solve for p~; see `contraction.display_contraction`."""
        return display_contraction(self.forward, self.base_plane, self.eye_box)

    def _forward(self, pixel: FloatArray, viewpoint: FloatArray, start: FloatArray | None) -> Answer:
        root = solve_display(self.forward, self.base_plane, pixel, viewpoint, start)
        inputs = joined(pixel, root.unknown)
        return Answer(self.forward(inputs), self.forward.box.contains(inputs), root.converged, root.unknown)

    def _backward(self, tangents: FloatArray, viewpoint: FloatArray, start: FloatArray | None) -> Answer:
        return pixel_answer(
            self.forward, self.backward_start, self.base_plane.carry(viewpoint, tangents), tangents, start
        )

    def _sensitivity(self, subject: FloatArray, viewpoint: FloatArray, tangents: FloatArray) -> Sensitivity:
        depth = self.base_plane.depth_along(viewpoint, tangents)
        inputs = joined(subject, viewpoint[:, :2] + depth[:, None] * tangents)
        _, jacobian = self.forward.with_jacobian(inputs, axes=(2, 3))
        # p~ moves with the tangents: t = f(pixel, p~(t)).
        along = np.eye(2) - jacobian @ self.base_plane.carry_by_tangents(depth, tangents)
        return Sensitivity(inputs, np.asarray(np.linalg.inv(along)))


@dataclass(frozen=True)
class BundleSeeThrough(FittedSeeThrough):
    """A `SeeThroughMapping` fitted on viewpoints in a plane and projected to all others.

    The forward query is in closed form, and its ray's point is the base-plane point plus the offset B. The backward
    query is iterative, and the view tangents (..., 2) are its warm start.

    Attributes:
        eye_box: box of valid viewpoints.
        base_plane: the plane of the fit.
        deviation: (x m, y m, tx, ty) -> (Ax, Ay, Bx m, By m).
        spread: covariance of `deviation`.
    """

    eye_box: EyeBox
    base_plane: BasePlane
    deviation: Regressor
    spread: Covariance | None = None

    FORMS: ClassVar[Forms] = {"deviation": (4, 4)}

    def contraction(self) -> float:
        """Contraction of the backward solve for the view tangents; see `contraction.see_through_contraction`."""

        def deviation_at(tangents: FloatArray, viewpoint: FloatArray) -> Deviation:
            return _deviation_at(self.deviation, self.base_plane, tangents, viewpoint)

        def contains(tangents: FloatArray, viewpoint: FloatArray) -> BoolArray:
            return self.deviation.box.contains(joined(self.base_plane.carry(viewpoint, tangents), tangents))

        box = self.deviation.box
        return see_through_contraction(deviation_at, contains, self.eye_box, Box(box.low[2:], box.high[2:]))

    def _forward(self, tangents: FloatArray, viewpoint: FloatArray, _: FloatArray | None) -> Answer:
        in_plane = self.base_plane.carry(viewpoint, tangents)
        inputs = joined(in_plane, tangents)
        value = self.deviation(inputs)
        ray = joined(in_plane + value[:, 2:], self.base_plane.z_at(in_plane)[:, None], tangents + value[:, :2])
        return Answer(ray, self.deviation.box.contains(inputs))

    def _backward(self, point: FloatArray, viewpoint: FloatArray, start: FloatArray | None) -> Answer:
        root = solve_see_through(self.deviation, self.base_plane, point, viewpoint, start)
        inputs = joined(self.base_plane.carry(viewpoint, root.unknown), root.unknown)
        inside = self.deviation.box.contains(inputs)
        return Answer(root.unknown, inside, root.converged, root.unknown)

    def _sensitivity(self, subject: FloatArray, viewpoint: FloatArray, tangents: FloatArray) -> Sensitivity:
        inputs = joined(self.base_plane.carry(viewpoint, tangents), tangents)
        deviation = _deviation_at(self.deviation, self.base_plane, tangents, viewpoint)
        return Sensitivity(inputs, deviation.view_by_value(1.0 / (viewpoint[:, 2] - subject[:, 2])))
