"""Common parts of lens models: their interface, projections to a plane, and the inverse of the distortion.

Camera frame: OpenCV's axes (x right, y down, z forward). Pixels have (0, 0) at the outer corner of the top-left pixel.
A lens model is an azimuthal projection of directions to a plane (gnomonic, equidistant or stereographic), followed by a
smooth distortion of the plane. All projections keep the direction away from the optical axis (z) and differ in the
distance from the centre as a function of the angle from the axis.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from wlr_render.geometry.directions import normalised
from wlr_render.numerics.arrays import FloatArray, IntArray
from wlr_render.numerics.newton import solve_2x2

_TOLERANCE = 1e-12  # tolerance of positions, in units of the focal length
_BATCH = 16384  # positions solved at once: their arrays stay in the processor's cache
_Profile = Callable[[FloatArray, FloatArray], FloatArray]


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
        """Return a copy of this lens with other values (P,) of its parameters."""

    def project(self, point_in_camera: FloatArray) -> Projection:
        """Project points (n, 3), with derivatives."""

    def pixel_of_point(self, point_in_camera: FloatArray) -> FloatArray:
        """Project points (..., 3) to pixels (..., 2); NaN for points that the model cannot see."""

    def dir_of_pixel(self, pixel: FloatArray) -> FloatArray:
        """Return the unit directions (..., 3) of pixels (..., 2); NaN for pixels without a direction."""

    def tangents_of_pixel(self, pixel: FloatArray) -> FloatArray:
        """Return the tangents (..., 2), x / z and y / z, of pixels (..., 2); NaN for pixels without a direction."""


def radians_per_pixel(lens: Lens, direction: FloatArray) -> FloatArray:
    """Return the angle (n,) per pixel at unit directions (n, 3), the geometric mean of both transverse axes."""
    slope = lens.project(direction).by_point
    # The derivative along the direction itself is zero: only the two transverse angles move the pixel.
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


@dataclass(frozen=True)
class Azimuthal:
    """An azimuthal projection with unit scale at the centre.

    Attributes:
        scale: (distance from the axis, z) -> ratio of the distance from the plane's centre to the distance from the
            axis; NaN or infinite for points without a position.
        growth: (distance from the axis, z) -> derivative of the distance from the centre by the angle from the axis.
        direction: positions (..., 2) in the plane -> unit directions (..., 3).
        angle: distance from the centre -> angle from the axis.
        largest_radius: upper bound of the distance from the centre.
    """

    scale: _Profile
    growth: _Profile
    direction: Callable[[FloatArray], FloatArray]
    angle: Callable[[float], float]
    largest_radius: float

    @np.errstate(divide="ignore", over="ignore", invalid="ignore")  # points without a position become NaN
    def position(self, point: FloatArray) -> FloatArray:
        """Project points (n, 3) to positions (n, 2); NaN for points without a position."""
        scale = self.scale(np.hypot(point[:, 0], point[:, 1]), point[:, 2])
        return np.asarray(point[:, :2] * scale[:, None])

    @np.errstate(divide="ignore", invalid="ignore")  # division by 0 on the axis
    def by_point(self, point: FloatArray) -> FloatArray:
        """Return the derivative (n, 2, 3) of `position`."""
        from_axis, z = np.hypot(point[:, 0], point[:, 1]), point[:, 2]
        outwards = np.where((from_axis == 0)[:, None], [1.0, 0.0], point[:, :2] / from_axis[:, None])
        # Derivative of the angle, times |point|^2.
        turn = np.concatenate([outwards * z[:, None], -from_axis[:, None]], axis=1)
        turn *= (self.growth(from_axis, z) / (from_axis**2 + z**2))[:, None]
        result = np.asarray(outwards[:, :, None] * turn[:, None, :])
        across = np.eye(2) - outwards[:, :, None] * outwards[:, None, :]
        result[:, :, :2] += self.scale(from_axis, z)[:, None, None] * across
        return result


def _direction_of_angles(position: FloatArray) -> FloatArray:
    angle = np.linalg.norm(position, axis=-1, keepdims=True)
    return np.concatenate([position * np.sinc(angle / np.pi), np.cos(angle)], axis=-1)


def _direction_of_stereographic(position: FloatArray) -> FloatArray:
    quarter = np.sum(position**2, axis=-1, keepdims=True) / 4.0
    return np.asarray(np.concatenate([position, 1.0 - quarter], axis=-1) / (1.0 + quarter))


def _direction_of_tangents(position: FloatArray) -> FloatArray:
    return normalised(np.concatenate([position, np.ones((*position.shape[:-1], 1))], axis=-1))


def _equidistant_scale(from_axis: FloatArray, z: FloatArray) -> FloatArray:
    on_axis = np.where(z > 0, 1.0 / z, np.nan)
    return np.where(from_axis > 0, np.arctan2(from_axis, z) / from_axis, on_axis)


GNOMONIC = Azimuthal(
    scale=lambda r, z: np.where(z > 0, 1.0 / z, np.nan),
    growth=lambda r, z: 1.0 + (r / z) ** 2,
    direction=_direction_of_tangents,
    angle=lambda radius: float(np.arctan(radius)),
    largest_radius=np.inf,
)
"""Tangents x / z, y / z: a pinhole camera. NaN for z <= 0."""

EQUIDISTANT = Azimuthal(
    scale=_equidistant_scale,
    growth=lambda r, z: np.ones_like(r),
    direction=_direction_of_angles,
    angle=float,
    largest_radius=np.pi,
)
"""The distance from the centre is the angle from the axis: an f-theta or fisheye lens."""

STEREOGRAPHIC = Azimuthal(
    scale=lambda r, z: 2.0 / (np.hypot(r, z) + z),
    growth=lambda r, z: 2.0 / (1.0 + z / np.hypot(r, z)),
    direction=_direction_of_stereographic,
    angle=lambda radius: float(2.0 * np.arctan(0.5 * radius)),
    largest_radius=np.inf,
)
"""The distance from the centre is 2 tan(angle / 2)."""
