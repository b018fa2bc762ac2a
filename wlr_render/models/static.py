"""Baseline that ignores the viewpoint: one map, fitted at the nominal viewpoint and used at every viewpoint.

The display is a fixed image at infinity; the see-through deviation depends on the direction only. The real ray is still
computed for the actual viewpoint: the deviation is taken at the nominal viewpoint, and the world is drawn from the
actual one.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from wlr_render.mappings import EyeBox, Panel
from wlr_render.models.fitted_model import Answer, FittedDisplay, FittedSeeThrough, Forms, Sensitivity, pixel_answer
from wlr_render.models.spread import Covariance
from wlr_render.models.volumetric import deviated_contraction, deviated_ray, deviated_sensitivity, deviated_view
from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.polynomial import Box, Polynomial, total_degree
from wlr_render.numerics.regressor import Regressor


@dataclass(frozen=True)
class StaticDisplay(FittedDisplay):
    """A `DisplayMapping` that is the same for every viewpoint.

    The warm start of the backward query is the pixel.

    Attributes:
        panel: the panel.
        eye_box: box of valid viewpoints; it affects the status only.
        forward: (u px, v px) -> (tx, ty).
        backward_start: (tx, ty) -> (u px, v px), where backward queries start.
    """

    panel: Panel
    eye_box: EyeBox
    forward: Regressor
    backward_start: Polynomial
    spread: Covariance | None = None

    FORMS: ClassVar[Forms] = {"forward": (2, 2), "backward_start": (2, 2)}

    def _forward(self, pixel: FloatArray, _viewpoint: FloatArray, _: FloatArray | None) -> Answer:
        return Answer(self.forward(pixel), self.forward.box.contains(pixel))

    def _backward(self, tangents: FloatArray, _viewpoint: FloatArray, start: FloatArray | None) -> Answer:
        return pixel_answer(self.forward, self.backward_start, _nowhere(tangents), tangents, start)

    def _sensitivity(self, subject: FloatArray, _viewpoint: FloatArray, tangents: FloatArray) -> Sensitivity:
        return Sensitivity(subject, np.broadcast_to(np.eye(2), (len(tangents), 2, 2)))


@dataclass(frozen=True)
class StaticSeeThrough(FittedSeeThrough):
    """A `SeeThroughMapping` whose deviation is the same for every viewpoint.

    The ray's point has the viewpoint's z. The warm start of the backward query is the view tangents.

    Attributes:
        eye_box: box of valid viewpoints; it affects the status only.
        forward: (tx, ty) -> (Ax, Ay, Bx m, By m), as in `VolumetricSeeThrough`.
    """

    eye_box: EyeBox
    forward: Regressor
    spread: Covariance | None = None

    FORMS: ClassVar[Forms] = {"forward": (2, 4)}

    def contraction(self) -> float:
        """Contraction of the backward solve; see `contraction.see_through_contraction`."""
        return deviated_contraction(self.forward, self.eye_box, _nowhere)

    def _forward(self, tangents: FloatArray, viewpoint: FloatArray, _: FloatArray | None) -> Answer:
        return deviated_ray(self.forward, _nowhere(tangents), tangents, viewpoint)

    def _backward(self, point: FloatArray, viewpoint: FloatArray, start: FloatArray | None) -> Answer:
        return deviated_view(self.forward, _nowhere(point), point, viewpoint, start)

    def _sensitivity(self, subject: FloatArray, viewpoint: FloatArray, tangents: FloatArray) -> Sensitivity:
        return deviated_sensitivity(self.forward, _nowhere(subject), subject, viewpoint, tangents)


def _nowhere(rows: FloatArray) -> FloatArray:
    """Return an empty place array (m, 0), for a model that ignores the viewpoint."""
    return np.empty((len(rows), 0))


def undeviated(eye_box: EyeBox) -> StaticSeeThrough:
    """Return the see-through mapping without optics: straight rays, for the baseline that ignores the combiner."""
    everywhere = Box(np.full(2, -10.0), np.full(2, 10.0))
    return StaticSeeThrough(eye_box, Polynomial(total_degree(2, 0), everywhere, np.zeros((1, 4))))
