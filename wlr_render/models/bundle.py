"""Planar (bundle) models of display and see-through: polynomials in the position on a base plane and the direction.

A viewpoint elsewhere is projected onto the base plane along its ray. Where the view direction is given (display
backward, see-through forward) the projection is `BasePlane.carry`, a closed form. Otherwise it is a 2 x 2 root-find,
for the point on the base plane (display forward) or for the view tangents (see-through backward). It takes about four
Newton steps from a cold start and fewer from the last frame's solution (paper: section 3.2).

See-through: at the base-plane point p~ and the view tangents t, the ray in the world passes through p~ + B(p~, t) in
the base plane and has tangents t + A(p~, t); no optics is A = B = 0. In terms of the paper's two planes P_real+ and
P_real- at depths Z+ and Z- in front of the base plane, its p_real+- are p~ + Z+- t + (B + Z+- A): the same two unknown
2-vectors, so both parametrisations span the same models for fronto-parallel planes. This one does not need the real
points to lie in two such planes.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from wlr_render.geometry.planes import BasePlane
from wlr_render.mappings import EyeBox, Panel
from wlr_render.models.fitted_model import Answer, FittedDisplay, FittedSeeThrough, Forms, joined
from wlr_render.numerics.arrays import FloatArray, IntArray
from wlr_render.numerics.newton import Residual, Root, solve_2x2
from wlr_render.numerics.polynomial import Polynomial

TOLERANCE = 1e-12
"""On the residual: metres in the base plane for the display, tangents for see-through."""


def solve_display(
    tangents_of: Polynomial, plane: BasePlane, pixel: FloatArray, viewpoint: FloatArray, start: FloatArray | None
) -> Root:
    """Solve for the point on the base plane of the ray from a pixel to a viewpoint.

    Solves p~ = viewpoint_xy + (viewpoint_z - plane_z) t(pixel, p~). Cold start: the viewpoint's x and y.

    Args:
        tangents_of: (u, v, x, y) -> (tx, ty), fitted on the plane.
        plane: the base plane.
        pixel: (n, 2).
        viewpoint: (n, 3).
        start: (n, 2) earlier solutions, or None.

    Returns:
        Root whose unknown is p~, (n, 2) metres.
    """
    depth = viewpoint[:, 2] - plane.z

    def residual(point: FloatArray, index: IntArray) -> tuple[FloatArray, FloatArray]:
        tangents, jacobian = tangents_of.with_jacobian(np.concatenate([pixel[index], point], axis=1), axes=(2, 3))
        dz = depth[index, None]
        return point - viewpoint[index, :2] - dz * tangents, np.eye(2) - dz[..., None] * jacobian

    return _solve_warm_then_cold(residual, start, viewpoint[:, :2])


def solve_see_through(
    deviation: Polynomial, plane: BasePlane, point: FloatArray, viewpoint: FloatArray, start: FloatArray | None
) -> Root:
    """Solve for the view direction of a real point.

    Unknown are the view tangents t at the viewpoint, so the solve does not degenerate for a viewpoint in the plane.
    With p~ = carry(viewpoint, t), the real ray leaves p~ + B with tangents t + A and misses the point laterally by
    p~ + B + Z (t + A) - point_xy, where Z is the point's depth in front of the plane. The residual is that miss over
    the point's depth in front of the eye: t - s + (Z A + B) / depth, with s the straight line's tangents, which are
    also the cold start.

    Args:
        deviation: (x, y, tx, ty) -> (A, B), see the module's docstring.
        plane: the base plane.
        point: (n, 3) in front of the viewpoint.
        viewpoint: (n, 3).
        start: (n, 2) earlier solutions, or None.

    Returns:
        Root whose unknown is t, (n, 2).
    """
    offset = (viewpoint[:, 2] - plane.z)[:, None]
    depth = (viewpoint[:, 2] - point[:, 2])[:, None]
    depth_from_plane = plane.depth_of(point)[:, None]
    straight = (point[:, :2] - viewpoint[:, :2]) / depth

    def residual(tangents: FloatArray, index: IntArray) -> tuple[FloatArray, FloatArray]:
        in_plane = viewpoint[index, :2] + offset[index] * tangents
        value, jacobian = deviation.with_jacobian(np.concatenate([in_plane, tangents], axis=1))
        # p~ moves with t as well.
        by_tangents = jacobian[..., 2:] + offset[index, :, None] * jacobian[..., :2]
        far, near = depth_from_plane[index] / depth[index], 1.0 / depth[index]
        bent = far * value[:, :2] + near * value[:, 2:]
        slope = far[..., None] * by_tangents[:, :2] + near[..., None] * by_tangents[:, 2:]
        return tangents - straight[index] + bent, np.eye(2) + slope

    return _solve_warm_then_cold(residual, start, straight)


def _solve_warm_then_cold(residual: Residual, start: FloatArray | None, cold: FloatArray) -> Root:
    if start is None:
        return solve_2x2(residual, cold, TOLERANCE)
    warm = solve_2x2(residual, np.where(np.isfinite(start), start, cold), TOLERANCE)
    lost = np.flatnonzero(~warm.converged)
    if lost.size == 0:
        return warm
    # Where the warm start fails, retry cold.
    again = solve_2x2(lambda unknown, index: residual(unknown, lost[index]), cold[lost], TOLERANCE)
    unknown, converged = warm.unknown.copy(), warm.converged.copy()
    unknown[lost], converged[lost] = again.unknown, again.converged
    return Root(unknown, converged, warm.iterations + again.iterations)


@dataclass(frozen=True)
class BundleDisplay(FittedDisplay):
    """`DisplayMapping` fitted on viewpoints in a plane and projected to all others.

    Viewpoints on the same ray of a pixel see it in the same direction, by construction.

    The forward query is iterative, and p~ (..., 2) is its warm start; the backward query is in closed form.

    Attributes:
        panel: the panel.
        eye_box: box of valid viewpoints.
        base_plane: the plane of the fit.
        forward: (u px, v px, x m, y m) -> (tx, ty).
        backward: (x m, y m, tx, ty) -> (u px, v px).
    """

    panel: Panel
    eye_box: EyeBox
    base_plane: BasePlane
    forward: Polynomial
    backward: Polynomial

    FORMS: ClassVar[Forms] = {"forward": (4, 2), "backward": (4, 2)}

    def _forward(self, pixel: FloatArray, viewpoint: FloatArray, start: FloatArray | None) -> Answer:
        root = solve_display(self.forward, self.base_plane, pixel, viewpoint, start)
        inputs = joined(pixel, root.unknown)
        return Answer(self.forward(inputs), self.forward.box.contains(inputs), root.converged, root.unknown)

    def _backward(self, tangents: FloatArray, viewpoint: FloatArray, _: FloatArray | None) -> Answer:
        in_plane = self.base_plane.carry(viewpoint, tangents)
        inputs = joined(in_plane, tangents)
        pixel = self.backward(inputs)
        # The box of directions has corners in which no fitted pixel is visible.
        inside = self.backward.box.contains(inputs) & self.forward.box.contains(joined(pixel, in_plane))
        return Answer(pixel, inside)


@dataclass(frozen=True)
class BundleSeeThrough(FittedSeeThrough):
    """`SeeThroughMapping` fitted on viewpoints in a plane and projected to all others.

    The forward query is in closed form, and its ray's point lies in the base plane. The backward query is iterative,
    and the view tangents (..., 2) are its warm start.

    Attributes:
        eye_box: box of valid viewpoints.
        base_plane: the plane of the fit.
        deviation: (x m, y m, tx, ty) -> (Ax, Ay, Bx m, By m).
    """

    eye_box: EyeBox
    base_plane: BasePlane
    deviation: Polynomial

    FORMS: ClassVar[Forms] = {"deviation": (4, 4)}

    def _forward(self, tangents: FloatArray, viewpoint: FloatArray, _: FloatArray | None) -> Answer:
        in_plane = self.base_plane.carry(viewpoint, tangents)
        inputs = joined(in_plane, tangents)
        value = self.deviation(inputs)
        origin = self.base_plane.lift(in_plane + value[:, 2:])
        ray = joined(origin, tangents + value[:, :2])
        return Answer(ray, self.deviation.box.contains(inputs))

    def _backward(self, point: FloatArray, viewpoint: FloatArray, start: FloatArray | None) -> Answer:
        root = solve_see_through(self.deviation, self.base_plane, point, viewpoint, start)
        inputs = joined(self.base_plane.carry(viewpoint, root.unknown), root.unknown)
        inside = self.deviation.box.contains(inputs)
        return Answer(root.unknown, inside, root.converged, root.unknown)
