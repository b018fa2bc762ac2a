"""Baseline with one 3-D point per pixel: the virtual image is a surface in space.

A point is stored as tangents a and inverse depth w at the nominal viewpoint c, because the image may cross infinity,
where w is zero. From the viewpoint v = c + d it is seen with tangents
t = (a - w d_xy) / (1 + w d_z), that is a - w q with q = d_xy + d_z t: where the ray meets the plane of c.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from wlr_render.mappings import EyeBox, Panel
from wlr_render.models.fitted_model import Answer, FittedDisplay, Sensitivity
from wlr_render.models.inverse import solve_warm_then_cold
from wlr_render.models.spread import Covariance
from wlr_render.numerics.arrays import FloatArray, IntArray
from wlr_render.numerics.polynomial import Polynomial


@dataclass(frozen=True)
class PointPerPixelDisplay(FittedDisplay):
    """`DisplayMapping` with one virtual point per pixel.

    The forward query is in closed form. The backward query is iterative, starts from the panel's centre, and has the
    pixel (..., 2) as its warm start.

    Attributes:
        panel: the panel.
        eye_box: box of valid viewpoints; its centre is the nominal viewpoint c.
        point: (u px, v px) -> (ax, ay, w 1/m).
    """

    panel: Panel
    eye_box: EyeBox
    point: Polynomial
    spread: Covariance | None = None

    MODELLED: ClassVar[str] = "point"

    def _forward(self, pixel: FloatArray, viewpoint: FloatArray, _: FloatArray | None) -> Answer:
        point = self.point(pixel)
        shift = viewpoint - self.eye_box.centre
        tangents = (point[:, :2] - point[:, 2:] * shift[:, :2]) / (1.0 + point[:, 2:] * shift[:, 2:])
        return Answer(tangents, self.point.box.contains(pixel))

    def _backward(self, tangents: FloatArray, viewpoint: FloatArray, start: FloatArray | None) -> Answer:
        shift = viewpoint - self.eye_box.centre
        crossing = shift[:, :2] + shift[:, 2:] * tangents

        def residual(pixel: FloatArray, index: IntArray) -> tuple[FloatArray, FloatArray]:
            point, jacobian = self.point.with_jacobian(pixel)
            miss = point[:, :2] - point[:, 2:] * crossing[index] - tangents[index]
            return miss, jacobian[:, :2] - crossing[index, :, None] * jacobian[:, 2:]

        cold = np.where(np.isfinite(tangents), 0.5 * self.panel.size_px, np.nan)
        root = solve_warm_then_cold(residual, start, cold)
        return Answer(root.unknown, self.point.box.contains(root.unknown), root.converged, root.unknown)

    def _sensitivity(self, subject: FloatArray, viewpoint: FloatArray, tangents: FloatArray) -> Sensitivity:
        shift = viewpoint - self.eye_box.centre
        by_depth = -(shift[:, :2] + shift[:, 2:] * tangents)[..., None]
        by_point = np.concatenate([np.broadcast_to(np.eye(2), (len(subject), 2, 2)), by_depth], axis=-1)
        return Sensitivity(subject, by_point / (1.0 + self.point(subject)[:, 2:] * shift[:, 2:])[..., None])
