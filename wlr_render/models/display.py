"""The planar display model: polynomials on the base plane behind a projection (paper: f_display over a bundle)."""

from dataclasses import dataclass
from typing import ClassVar

from wlr_render.geometry.directions import dir_of_tangents
from wlr_render.geometry.planes import BasePlane
from wlr_render.mappings import EyeBox, Panel
from wlr_render.models.base import FittedDisplay
from wlr_render.models.bundle_projection import solve_display
from wlr_render.models.queries import Answer, Forms, joined
from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.polynomial import Polynomial


@dataclass(frozen=True)
class BundleDisplay(FittedDisplay):
    """`DisplayMapping` fitted on viewpoints in a plane and projected to all others.

    Two viewpoints on one ray of a pixel see it in one direction, by construction.

    The forward query is a solve, whose warm start is p~, (..., 2); the backward one is a closed form.

    Attributes:
        panel: the panel.
        eye_box: where the pupil may be.
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
        view_dir = dir_of_tangents(self.forward(inputs))
        return Answer(view_dir, self.forward.box.contains(inputs), root.converged, root.unknown)

    def _backward(self, tangents: FloatArray, viewpoint: FloatArray, _: FloatArray | None) -> Answer:
        in_plane = self.base_plane.carry(viewpoint, tangents)
        inputs = joined(in_plane, tangents)
        pixel = self.backward(inputs)
        # The box of directions holds corners that no fitted pixel is seen in.
        inside = self.backward.box.contains(inputs) & self.forward.box.contains(joined(pixel, in_plane))
        return Answer(pixel, inside)
