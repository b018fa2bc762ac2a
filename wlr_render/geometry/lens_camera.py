"""A camera with lens distortion: a pinhole in OpenCV's axes (x right, y down, z forward) behind Brown's distortion.

Pixels have (0, 0) at the outer corner of the top-left pixel. OpenCV counts from that pixel's centre;
`opencv_matrix` and `OPENCV_PIXEL_SHIFT` convert.
"""

from dataclasses import dataclass, field
from functools import partial

import numpy as np

from wlr_render.geometry.directions import normalised
from wlr_render.numerics.arrays import FloatArray

OPENCV_PIXEL_SHIFT = -0.5
"""OpenCV's pixel position minus ours."""

DISTORTION_TERMS = ("k1", "k2", "p1", "p2", "k3")
"""Distortion coefficients in OpenCV's order."""
LENS_PARAMETERS = ("fx", "fy", "cx", "cy", *DISTORTION_TERMS)
"""All parameters of a lens, in the order of OpenCV's derivatives."""

_TOLERANCE = 1e-12  # of distorted tangents
_STEPS = 8  # of Newton's method; five reach rounding error for lenses of 90 degrees
_REACH = 1.5  # largest true tangent searched, relative to the undistorted tangents of the image edges


@dataclass(frozen=True, eq=False)
class LensCamera:
    """A camera with Brown's lens distortion.

    Attributes:
        size_px: width and height.
        focal_px: (2,) pixels per unit tangent in u and v.
        centre_px: (2,) principal point.
        distortion: (5,) the `DISTORTION_TERMS` of D. C. Brown, "Close-range camera calibration", Photogrammetric
            Engineering 37 (1971) 855: distorted tangents as a polynomial of true tangents.
    """

    size_px: tuple[int, int]
    focal_px: FloatArray
    centre_px: FloatArray
    distortion: FloatArray = field(default_factory=partial(np.zeros, len(DISTORTION_TERMS)))

    @property
    def opencv_matrix(self) -> FloatArray:
        """Camera matrix (3, 3) for OpenCV's pixel positions."""
        (fx, fy), (cx, cy) = self.focal_px, self.centre_px + OPENCV_PIXEL_SHIFT
        return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])

    def pixel_of_tangents(self, tangents: FloatArray) -> FloatArray:
        """Project tangents (..., 2), (x / z, y / z) in the camera frame, to pixels (..., 2)."""
        return np.asarray(self._distorted(np.asarray(tangents)) * self.focal_px + self.centre_px)

    def pixel_of_point(self, point_in_camera: FloatArray) -> FloatArray:
        """Project points (..., 3) to pixels (..., 2); NaN for points not in front of the camera."""
        depth = np.where(point_in_camera[..., 2:] > 0, point_in_camera[..., 2:], np.nan)
        return self.pixel_of_tangents(point_in_camera[..., :2] / depth)

    def tangents_of_pixel(self, pixel: FloatArray) -> FloatArray:
        """Undistorted tangents (..., 2) of pixels (..., 2); NaN where the distortion has no inverse near the image."""
        seen = ((np.asarray(pixel, dtype=np.float64) - self.centre_px) / self.focal_px).reshape(-1, 2)
        if not np.any(self.distortion):
            return seen.reshape(np.shape(pixel))

        true = seen
        for _ in range(_STEPS):
            miss = self._distorted(true) - seen
            if not np.any(np.abs(miss) > 0.1 * _TOLERANCE):
                break
            true = true - _solved(self._slope(true), miss)
        limit = _REACH * np.max(np.abs(np.array([[0, 0], self.size_px]) - self.centre_px) / self.focal_px)
        miss = np.abs(self._distorted(true) - seen).max(axis=-1)
        sound = (miss <= _TOLERANCE) & (np.abs(true).max(axis=-1) <= limit)
        return np.where(sound[:, None], true, np.nan).reshape(np.shape(pixel))

    def dir_of_pixel(self, pixel: FloatArray) -> FloatArray:
        """Unit directions (..., 3) of pixels (..., 2) in the camera frame."""
        tangents = self.tangents_of_pixel(pixel)
        return normalised(np.concatenate([tangents, np.ones((*tangents.shape[:-1], 1))], axis=-1))

    def _distorted(self, tangents: FloatArray) -> FloatArray:
        k1, k2, p1, p2, k3 = self.distortion
        x, y = tangents[..., 0], tangents[..., 1]
        r2 = x * x + y * y
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        return np.stack(
            [
                x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
                y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
            ],
            axis=-1,
        )

    def _slope(self, tangents: FloatArray) -> FloatArray:
        """Jacobian (..., 2, 2) of `_distorted`."""
        k1, k2, p1, p2, k3 = self.distortion
        x, y = tangents[..., 0], tangents[..., 1]
        r2 = x * x + y * y
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        growth = 2 * (k1 + r2 * (2 * k2 + 3 * r2 * k3))
        cross = x * y * growth + 2 * p1 * x + 2 * p2 * y
        return np.stack(
            [
                np.stack([radial + x * x * growth + 2 * p1 * y + 6 * p2 * x, cross], axis=-1),
                np.stack([cross, radial + y * y * growth + 6 * p1 * y + 2 * p2 * x], axis=-1),
            ],
            axis=-2,
        )


@np.errstate(divide="ignore", invalid="ignore", over="ignore")  # singular systems become NaN or very large
def _solved(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """Solve matrix (n, 2, 2) @ x = right (n, 2) for x."""
    (a, b), (c, d) = np.moveaxis(matrix, 0, -1)
    first, second = right.T
    return np.asarray(np.stack([d * first - b * second, a * second - c * first], axis=-1) / (a * d - b * c)[:, None])
