"""From where an intermediate image is best drawn: the point that all bent rays pass nearest to.

A raster camera at the viewpoint does not see along the bent rays, which pass beside it by up to millimetres; behind an
edge it misses what they meet. Most of that offset is common to all rays: a thick see-through element makes the eye
appear elsewhere, and a camera at that place sees almost along the rays.
"""

import itertools

import numpy as np

from wlr_render.geometry import transforms
from wlr_render.mappings import EyeMappings
from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.polynomial import Box, Polynomial, basis
from wlr_render.rendering.ray_field import solve_pixels

_GRID = 7
_DEGREE = 2


def nearest_point_to_rays(bend: FloatArray) -> FloatArray:
    """The point (3,) that minimises the squares of the rays' offsets from it, in the rays' camera frame.

    A ray is at (c - a z, d - b z, z); its offset from (x, y, z) is measured across the viewing axis, so that the
    point is a regression of (c, d) on (a, b): (c, d) = (x, y) + z (a, b).

    Args:
        bend: (4, ...), (a, b, c, d) as `RayField.bend`; rays with a NaN do not count.

    Returns:
        The point; the origin where no ray counts, and z = 0 where all are parallel.
    """
    rays = np.asarray(bend, dtype=np.float64).reshape(4, -1)
    rays = rays[:, np.isfinite(rays).all(axis=0)]
    if rays.shape[1] == 0:
        return np.zeros(3)
    mean = rays.mean(axis=1)
    tangents, offset = np.split(rays - mean[:, None], 2)
    spread = np.sum(tangents * tangents)
    z = np.sum(tangents * offset) / spread if spread > 0 else 0.0
    return np.array([*(mean[2:] - z * mean[:2]), z])


class RasterEye:
    """The best place of a raster camera for any viewpoint: a polynomial fitted to some of them over the eye box."""

    def __init__(self, mappings: EyeMappings, device_from_camera: FloatArray) -> None:
        """Fit; best for a camera with these axes (3, 3), across whose viewing axis offsets are measured."""
        eye_box, pixel = mappings.eye_box, mappings.display.panel.grid(_GRID, _GRID)
        half = 0.5 * np.maximum(eye_box.size, 1e-6)
        self._box = Box(eye_box.centre - half, eye_box.centre + half)
        viewpoints = eye_box.centre + half * np.array(list(itertools.product((-1.0, 0.0, 1.0), repeat=3)))
        shift_in_camera = [
            nearest_point_to_rays(np.moveaxis(solve_pixels(mappings, device_from_camera, pixel, each).bend, -1, 0))
            for each in viewpoints
        ]
        shift = transforms.rotate(device_from_camera, np.array(shift_in_camera))
        coefficients, *_ = np.linalg.lstsq(basis(viewpoints, _DEGREE, self._box), shift)
        self._shift = Polynomial(_DEGREE, self._box, coefficients.astype(np.float64))

    def at(self, viewpoint: FloatArray) -> FloatArray:
        """The place (..., 3) for viewpoints (..., 3), both in the device frame.

        Outside the eye box the shift is that of the box's nearest point, so that it neither jumps nor grows.
        """
        return np.asarray(viewpoint + self._shift(np.clip(viewpoint, self._box.low, self._box.high)))
