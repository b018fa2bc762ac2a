"""Baseline of volumetric sampling: four maps fitted directly over viewpoints in a volume, all in closed form.

The model does not enforce that viewpoints on the same ray of a pixel see it in the same direction.
"""

from dataclasses import dataclass
from typing import ClassVar

from wlr_render.mappings import EyeBox, Panel
from wlr_render.models.fitted_model import Answer, FittedDisplay, FittedSeeThrough, Forms, joined
from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.polynomial import Polynomial


@dataclass(frozen=True)
class VolumetricDisplay(FittedDisplay):
    """`DisplayMapping` fitted on viewpoints in a volume.

    Attributes:
        panel: the panel.
        eye_box: box of valid viewpoints.
        forward: (u px, v px, x m, y m, z m) -> (tx, ty).
        backward: (x m, y m, z m, tx, ty) -> (u px, v px).
    """

    panel: Panel
    eye_box: EyeBox
    forward: Polynomial
    backward: Polynomial

    FORMS: ClassVar[Forms] = {"forward": (5, 2), "backward": (5, 2)}

    def _forward(self, pixel: FloatArray, viewpoint: FloatArray, _: FloatArray | None) -> Answer:
        inputs = joined(pixel, viewpoint)
        return Answer(self.forward(inputs), self.forward.box.contains(inputs))

    def _backward(self, tangents: FloatArray, viewpoint: FloatArray, _: FloatArray | None) -> Answer:
        inputs = joined(viewpoint, tangents)
        pixel = self.backward(inputs)
        inside = self.backward.box.contains(inputs) & self.forward.box.contains(joined(pixel, viewpoint))
        return Answer(pixel, inside)


@dataclass(frozen=True)
class VolumetricSeeThrough(FittedSeeThrough):
    """`SeeThroughMapping` fitted on viewpoints in a volume.

    Forward, the ray in the world passes through viewpoint_xy + B at the viewpoint's own z and has tangents t + A.
    Backward, a point at depth D in front of the viewpoint, straight tangents s, is seen at t = s + a + b / D: linear in
    inverse depth, so that two target depths determine it (the product of two deviations is neglected).

    Attributes:
        eye_box: box of valid viewpoints.
        forward: (x m, y m, z m, tx, ty) -> (Ax, Ay, Bx m, By m).
        backward: (x m, y m, z m, sx, sy) -> (ax, ay, bx m, by m).
    """

    eye_box: EyeBox
    forward: Polynomial
    backward: Polynomial

    FORMS: ClassVar[Forms] = {"forward": (5, 4), "backward": (5, 4)}

    def _forward(self, tangents: FloatArray, viewpoint: FloatArray, _: FloatArray | None) -> Answer:
        return deviated_ray(self.forward, joined(viewpoint, tangents), tangents, viewpoint)

    def _backward(self, point: FloatArray, viewpoint: FloatArray, _: FloatArray | None) -> Answer:
        tangents, depth = straight_tangents(point, viewpoint)
        return deviated_view(self.backward, joined(viewpoint, tangents), tangents, depth)


def straight_tangents(point: FloatArray, viewpoint: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Tangents (m, 2) of the straight line from viewpoints to points, and the points' depth (m, 1)."""
    depth = viewpoint[:, 2:] - point[:, 2:]
    return (point[:, :2] - viewpoint[:, :2]) / depth, depth


def deviated_ray(forward: Polynomial, inputs: FloatArray, tangents: FloatArray, viewpoint: FloatArray) -> Answer:
    """The ray through viewpoint_xy + B at the viewpoint's z, with tangents t + A."""
    value = forward(inputs)
    origin = joined(viewpoint[:, :2] + value[:, 2:], viewpoint[:, 2:])
    return Answer(joined(origin, tangents + value[:, :2]), forward.box.contains(inputs))


def deviated_view(backward: Polynomial, inputs: FloatArray, tangents: FloatArray, depth: FloatArray) -> Answer:
    """The view direction with tangents s + a + b / depth."""
    value = backward(inputs)
    seen = tangents + value[:, :2] + value[:, 2:] / depth
    return Answer(seen, backward.box.contains(inputs))
