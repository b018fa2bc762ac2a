"""Interface of all lens models, and the inverse of their distortion.

Camera frame: OpenCV's axes (x right, y down, z forward). Pixels have (0, 0) at the outer corner of the top-left pixel.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from wlr_render.numerics.arrays import FloatArray, IntArray
from wlr_render.numerics.newton import solve_2x2

_TOLERANCE = 1e-12  # tolerance of positions, in units of the focal length
_BATCH = 16384  # positions solved at once: their arrays stay in the processor's cache


@dataclass(frozen=True, eq=False)
class Projection:
    """Pixels of points, with derivatives. Rows of points that the lens model cannot see are NaN.

    Attributes:
        pixel: (n, 2).
        by_point: (n, 2, 3) derivative by the point in the camera frame, pixels per metre.
        by_values: (n, 2, P) derivative by `Lens.values`.
    """

    pixel: FloatArray
    by_point: FloatArray
    by_values: FloatArray


class Lens(Protocol):
    """A camera with a lens: pixels of points and directions of pixels."""

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height."""

    @property
    def focal_px(self) -> FloatArray:
        """(2,) pixels per unit of the undistorted image in u and v, at its centre."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the P parameters that a fit can estimate."""

    @property
    def values(self) -> FloatArray:
        """Values (P,) of the parameters that a fit can estimate."""

    def with_values(self, values: FloatArray) -> "Lens":
        """Copy of this lens with other values (P,) of its parameters."""

    def project(self, point_in_camera: FloatArray) -> Projection:
        """Project points (n, 3), with derivatives."""

    def pixel_of_point(self, point_in_camera: FloatArray) -> FloatArray:
        """Project points (..., 3) to pixels (..., 2); NaN for points that the model cannot see."""

    def dir_of_pixel(self, pixel: FloatArray) -> FloatArray:
        """Return the unit directions (..., 3) of pixels (..., 2); NaN for pixels without a direction."""

    def tangents_of_pixel(self, pixel: FloatArray) -> FloatArray:
        """Return the tangents (..., 2), x / z and y / z, of pixels (..., 2); NaN for pixels without a direction."""


def radians_per_pixel(lens: Lens, direction: FloatArray) -> FloatArray:
    """Return angle (n,) that one pixel spans at unit directions (n, 3), geometric mean of the two transverse axes."""
    slope = lens.project(direction).by_point
    # The derivative along the direction itself is zero: the rest maps the two transverse angles to pixels.
    return np.asarray(np.linalg.det(slope @ np.swapaxes(slope, 1, 2)) ** -0.25)


def undistorted(
    target: FloatArray, start: FloatArray, distorted: Callable[[FloatArray], tuple[FloatArray, FloatArray]]
) -> FloatArray:
    """Solve distorted(position) = target; NaN where Newton's method finds no solution.

    Args:
        target: (n, 2) distorted positions, in focal lengths.
        start: (n, 2) first guess.
        distorted: position (m, 2) -> distorted position (m, 2), NaN outside the model's limit; and its Jacobian
            (m, 2, 2).
    """
    position = np.empty_like(target)
    for first in range(0, len(target), _BATCH):
        rows = slice(first, first + _BATCH)
        position[rows] = _solved(target[rows], start[rows], distorted)
    return position


def _solved(
    target: FloatArray, start: FloatArray, distorted: Callable[[FloatArray], tuple[FloatArray, FloatArray]]
) -> FloatArray:
    def residual(position: FloatArray, index: IntArray) -> tuple[FloatArray, FloatArray]:
        value, jacobian = distorted(position)
        return value - target[index], jacobian

    root = solve_2x2(residual, start, _TOLERANCE)
    return np.where(root.converged[:, None], root.unknown, np.nan)
