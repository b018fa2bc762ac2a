"""Baseline of volumetric sampling: maps fitted directly over viewpoints in a volume.

The forward queries are in closed form, the backward ones solve them. The model does not enforce that viewpoints on the
same ray of a pixel see it in the same direction.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from wlr_render.mappings import EyeBox, Panel
from wlr_render.models.contraction import see_through_contraction
from wlr_render.models.fitted_model import (
    Answer,
    FittedDisplay,
    FittedSeeThrough,
    Forms,
    Sensitivity,
    joined,
    pixel_answer,
)
from wlr_render.models.inverse import Deviation, solve_view_tangents
from wlr_render.models.spread import Covariance
from wlr_render.numerics.arrays import BoolArray, FloatArray, IntArray
from wlr_render.numerics.polynomial import Box, Polynomial
from wlr_render.numerics.regressor import Regressor


@dataclass(frozen=True)
class VolumetricDisplay(FittedDisplay):
    """A `DisplayMapping` fitted on viewpoints in a volume.

    The warm start of the backward query is the pixel.

    Attributes:
        panel: the panel.
        eye_box: box of valid viewpoints.
        forward: (u px, v px, x m, y m, z m) -> (tx, ty).
        backward_start: (x m, y m, z m, tx, ty) -> (u px, v px), where backward queries start.
    """

    panel: Panel
    eye_box: EyeBox
    forward: Regressor
    backward_start: Polynomial
    spread: Covariance | None = None

    FORMS: ClassVar[Forms] = {"forward": (5, 2), "backward_start": (5, 2)}

    def _forward(self, pixel: FloatArray, viewpoint: FloatArray, _: FloatArray | None) -> Answer:
        inputs = joined(pixel, viewpoint)
        return Answer(self.forward(inputs), self.forward.box.contains(inputs))

    def _backward(self, tangents: FloatArray, viewpoint: FloatArray, start: FloatArray | None) -> Answer:
        return pixel_answer(self.forward, self.backward_start, viewpoint, tangents, start)

    def _sensitivity(self, subject: FloatArray, viewpoint: FloatArray, tangents: FloatArray) -> Sensitivity:
        return Sensitivity(joined(subject, viewpoint), np.broadcast_to(np.eye(2), (len(tangents), 2, 2)))


@dataclass(frozen=True)
class VolumetricSeeThrough(FittedSeeThrough):
    """A `SeeThroughMapping` fitted on viewpoints in a volume.

    The ray in the world passes through viewpoint_xy + B at the viewpoint's own z and has tangents t + A. The warm start
    of the backward query is the view tangents t.

    Attributes:
        eye_box: box of valid viewpoints.
        forward: (x m, y m, z m, tx, ty) -> (Ax, Ay, Bx m, By m).
    """

    eye_box: EyeBox
    forward: Regressor
    spread: Covariance | None = None

    FORMS: ClassVar[Forms] = {"forward": (5, 4)}

    def contraction(self) -> float:
        """Contraction of the backward solve; see `contraction.see_through_contraction`."""
        return deviated_contraction(self.forward, self.eye_box, lambda viewpoint: viewpoint)

    def _forward(self, tangents: FloatArray, viewpoint: FloatArray, _: FloatArray | None) -> Answer:
        return deviated_ray(self.forward, viewpoint, tangents, viewpoint)

    def _backward(self, point: FloatArray, viewpoint: FloatArray, start: FloatArray | None) -> Answer:
        return deviated_view(self.forward, viewpoint, point, viewpoint, start)

    def _sensitivity(self, subject: FloatArray, viewpoint: FloatArray, tangents: FloatArray) -> Sensitivity:
        return deviated_sensitivity(self.forward, viewpoint, subject, viewpoint, tangents)


def deviated_contraction(forward: Regressor, eye_box: EyeBox, place_of: Callable[[FloatArray], FloatArray]) -> float:
    """Return the contraction of `deviated_view`, for the places (m, any) of viewpoints (m, 3)."""
    box = Box(forward.box.low[-2:], forward.box.high[-2:])

    def contains(tangents: FloatArray, viewpoint: FloatArray) -> BoolArray:
        return forward.box.contains(joined(place_of(viewpoint), tangents))

    def deviation_at(tangents: FloatArray, viewpoint: FloatArray) -> Deviation:
        return _deviation(forward, place_of(viewpoint), tangents)

    return see_through_contraction(deviation_at, contains, eye_box, box)


def _deviation(forward: Regressor, place: FloatArray, tangents: FloatArray) -> Deviation:
    by = place.shape[1], place.shape[1] + 1
    return Deviation.at_viewpoint(*forward.with_jacobian(joined(place, tangents), axes=by))


def deviated_ray(forward: Regressor, place: FloatArray, tangents: FloatArray, viewpoint: FloatArray) -> Answer:
    """Return the ray through viewpoint_xy + B at the viewpoint's z, with tangents t + A; A and B at (place, t)."""
    inputs = joined(place, tangents)
    value = forward(inputs)
    origin = joined(viewpoint[:, :2] + value[:, 2:], viewpoint[:, 2:])
    return Answer(joined(origin, tangents + value[:, :2]), forward.box.contains(inputs))


def deviated_view(
    forward: Regressor, place: FloatArray, point: FloatArray, viewpoint: FloatArray, start: FloatArray | None
) -> Answer:
    """Return the view direction whose `deviated_ray` passes through the point."""
    forward_at = forward.held(range(place.shape[1]), place)

    def deviation_at(tangents: FloatArray, index: IntArray) -> Deviation:
        return Deviation.at_viewpoint(*forward_at.with_jacobian(tangents, index))

    root = solve_view_tangents(deviation_at, point, viewpoint, start, forward.rounding)
    inside = forward.box.contains(joined(place, root.unknown))
    return Answer(root.unknown, inside, root.converged, root.unknown)


def deviated_sensitivity(
    forward: Regressor, place: FloatArray, point: FloatArray, viewpoint: FloatArray, tangents: FloatArray
) -> Sensitivity:
    """Return the derivative of `deviated_view` by the polynomial."""
    by_value = _deviation(forward, place, tangents).view_by_value(1.0 / (viewpoint[:, 2] - point[:, 2]))
    return Sensitivity(joined(place, tangents), by_value)
