"""The planar display model: polynomials on the base plane behind a projection (paper: f_display over a bundle)."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from wlr_render.geometry.directions import dir_of_tangents, tangents_of_dir
from wlr_render.geometry.planes import BasePlane
from wlr_render.mappings import EyeBox, Mapped, Panel
from wlr_render.models.bundle_projection import solve_display
from wlr_render.models.queries import Answer, Forms, answer_in_chunks, joined, require_forms
from wlr_render.numerics.polynomial import Polynomial

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class BundleDisplay:
    """`DisplayMapping` fitted on viewpoints in a plane and projected to all others.

    Two viewpoints on one ray of a pixel see it in one direction, by construction.

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

    def __post_init__(self) -> None:
        require_forms(self, self.FORMS)

    def view_dir_of_pixel(
        self, pixel: FloatArray, viewpoint: FloatArray, warm_start: FloatArray | None = None
    ) -> Mapped:
        """Forward, by a solve; see `mappings.DisplayMapping`. The warm start is p~, (..., 2)."""
        return answer_in_chunks(self._forward, pixel, viewpoint, self.eye_box, warm_start)

    def pixel_of_view_dir(
        self, view_dir: FloatArray, viewpoint: FloatArray, warm_start: FloatArray | None = None
    ) -> Mapped:
        """Backward, closed form; see `mappings.DisplayMapping`."""
        return answer_in_chunks(self._backward, tangents_of_dir(np.asarray(view_dir)), viewpoint, self.eye_box)

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
