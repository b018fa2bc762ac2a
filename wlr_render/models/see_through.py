"""The planar see-through model: the deviation from the straight ray, on the base plane behind a projection.

At the base-plane point p~ and the view tangents t, the ray in the world passes through p~ + B(p~, t) in the base plane
and has tangents t + A(p~, t); no optics is A = B = 0. In terms of the paper's two planes P_real+ and P_real- at depths
Z+ and Z- in front of the base plane, its p_real+- are p~ + Z+- t + (B + Z+- A): the same two unknown 2-vectors, so
both parametrisations span the same models for fronto-parallel planes. This one does not need the real points to lie in
two such planes.
"""

from dataclasses import dataclass
from typing import ClassVar

from wlr_render.geometry.directions import dir_of_tangents
from wlr_render.geometry.planes import BasePlane
from wlr_render.mappings import EyeBox
from wlr_render.models.base import FittedSeeThrough
from wlr_render.models.bundle_projection import solve_see_through
from wlr_render.models.queries import Answer, Forms, joined
from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.polynomial import Polynomial


@dataclass(frozen=True)
class BundleSeeThrough(FittedSeeThrough):
    """`SeeThroughMapping` fitted on viewpoints in a plane and projected to all others.

    The forward query is a closed form, and its ray's point lies in the base plane; the backward one is a solve, whose
    warm start is the view tangents, (..., 2).

    Attributes:
        eye_box: where the pupil may be.
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
        ray = joined(origin, dir_of_tangents(tangents + value[:, :2]))
        return Answer(ray, self.deviation.box.contains(inputs))

    def _backward(self, point: FloatArray, viewpoint: FloatArray, start: FloatArray | None) -> Answer:
        root = solve_see_through(self.deviation, self.base_plane, point, viewpoint, start)
        inputs = joined(self.base_plane.carry(viewpoint, root.unknown), root.unknown)
        inside = self.deviation.box.contains(inputs)
        return Answer(dir_of_tangents(root.unknown), inside, root.converged, root.unknown)
