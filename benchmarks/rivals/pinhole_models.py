"""Models of a headset as a projector with a flat virtual image; see `pinhole` for the methods that fit them.

The display maps homogeneous pixels to directions by a 3 x 3 matrix that is linear in the viewpoint:
direction ~ (matrix - (viewpoint - position) inverse_depth^T) (u, v, 1). Without an inverse depth the image lies at
infinity.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from wlr_render.mappings import EyeBox, Panel
from wlr_render.models.fitted_model import Answer, FittedDisplay, FittedSeeThrough, joined
from wlr_render.numerics.arrays import FloatArray, IntArray
from wlr_render.numerics.polynomial import Box


@dataclass(frozen=True, eq=False)
class PinholeDisplay(FittedDisplay):
    """`DisplayMapping` by one 3 x 3 matrix for each camera position; a viewpoint uses the nearest position.

    Both queries are in closed form.

    Attributes:
        panel: the panel.
        eye_box: box of valid viewpoints; it affects the status only.
        box: box of the pixels (u px, v px) of the fit.
        position: (k, 3) camera positions, metres.
        matrix: (k, 3, 3) maps from (u, v, 1) to the direction from each position.
        inverse_depth: (k, 3) maps from (u, v, 1) to the homogeneous coordinate of the image point, 1/m in the unit of
            `matrix`; zero for an image at infinity.
        numbers: number of numbers to be stored.
    """

    panel: Panel
    eye_box: EyeBox
    box: Box
    position: FloatArray
    matrix: FloatArray
    inverse_depth: FloatArray
    numbers: int

    def tangents(self, pixel: FloatArray, viewpoint: FloatArray) -> FloatArray:
        """Return the view tangents (m, 2) of pixels (m, 2) from viewpoints (m, 3), metres.

        They are NaN if a pixel lies behind the viewpoint.
        """
        direction = np.einsum("nij,nj->ni", self._matrices(viewpoint), homogeneous(pixel))
        return np.asarray(direction[:, :2] / np.where(direction[:, 2:] < 0.0, -direction[:, 2:], np.nan))

    def _forward(self, pixel: FloatArray, viewpoint: FloatArray, _: FloatArray | None) -> Answer:
        return Answer(self.tangents(pixel, viewpoint), self.box.contains(pixel))

    def _backward(self, tangents: FloatArray, viewpoint: FloatArray, _: FloatArray | None) -> Answer:
        first, second, third = np.moveaxis(self._matrices(viewpoint), -1, 0)
        # The inverse without division by the determinant, which is zero for a viewpoint in the image.
        adjugate = np.stack([np.cross(second, third), np.cross(third, first), np.cross(first, second)], axis=1)
        determinant = np.sum(first * adjugate[:, 0], axis=1, keepdims=True)
        seen = np.einsum("nij,nj->ni", adjugate, joined(tangents, -np.ones((len(tangents), 1))))
        pixel = seen[:, :2] / np.where(seen[:, 2:] * determinant > 0.0, seen[:, 2:], np.nan)
        return Answer(pixel, self.box.contains(pixel))

    def _matrices(self, viewpoint: FloatArray) -> FloatArray:
        """Return the matrices (m, 3, 3) at viewpoints (m, 3)."""
        index = _nearest(self.position, viewpoint)
        shift = viewpoint - self.position[index]
        return np.asarray(self.matrix[index] - shift[:, :, None] * self.inverse_depth[index][:, None, :])


@dataclass(frozen=True, eq=False)
class FixedEyeSeeThrough(FittedSeeThrough):
    """`SeeThroughMapping` of straight rays to one eye for each camera position; a viewpoint uses the nearest position.

    Together with SPAAM's display, which does not separate display and see-through, it gives SPAAM's projection.

    Attributes:
        eye_box: box of valid viewpoints; it affects the status only.
        position: (k, 3) camera positions, metres.
        eye: (k, 3) assumed positions of the eye, metres.
    """

    eye_box: EyeBox
    position: FloatArray
    eye: FloatArray

    def _forward(self, tangents: FloatArray, viewpoint: FloatArray, _: FloatArray | None) -> Answer:
        eye = self.eye[_nearest(self.position, viewpoint)]
        return Answer(joined(eye, tangents), np.ones(len(tangents), bool))

    def _backward(self, point: FloatArray, viewpoint: FloatArray, _: FloatArray | None) -> Answer:
        to_point = point - self.eye[_nearest(self.position, viewpoint)]
        tangents = to_point[:, :2] / np.where(to_point[:, 2:] < 0.0, -to_point[:, 2:], np.nan)
        return Answer(tangents, np.ones(len(tangents), bool))


def _nearest(position: FloatArray, viewpoint: FloatArray) -> IntArray:
    """Return the index (m,) of the position (k, 3) nearest to viewpoints (m, 3); 0 for non-finite viewpoints."""
    finite = np.where(np.isfinite(viewpoint), viewpoint, 0.0)
    return np.asarray(cKDTree(position).query(finite)[1], np.int64)


def homogeneous(points: FloatArray) -> FloatArray:
    """Append a column of ones to points (n, d): (n, d + 1)."""
    return joined(points, np.ones((len(points), 1)))
