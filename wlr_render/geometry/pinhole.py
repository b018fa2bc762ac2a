"""The pinhole camera of the device frame: it looks along -z, y up; pixel (0, 0) is the outer corner, v runs down."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from wlr_render.numerics.arrays import BoolArray, Float32Array, FloatArray, read_only


@dataclass(frozen=True, eq=False)
class Pinhole:
    """An off-axis pinhole camera with the axes of the device frame: pixels are affine in the tangents.

    Attributes:
        width_px, height_px: image size.
        tangent_min: (2,) tangents (tx, ty) of the left and bottom image edges.
        tangent_max: (2,) tangents of the right and top image edges.
    """

    width_px: int
    height_px: int
    tangent_min: FloatArray
    tangent_max: FloatArray

    @classmethod
    def covering(cls, tangents: FloatArray, pixels_per_tangent: float, margin_px: int = 2) -> "Pinhole":
        """Return the smallest camera that contains all finite `tangents` (..., 2) at a given resolution."""
        flat = tangents.reshape(-1, 2)
        flat = flat[np.isfinite(flat).all(axis=1)]
        low, high = flat.min(axis=0), flat.max(axis=0)
        size = np.ceil((high - low) * pixels_per_tangent).astype(int) + 2 * margin_px
        centre, half = 0.5 * (low + high), 0.5 * size / pixels_per_tangent
        return cls(int(size[0]), int(size[1]), centre - half, centre + half)

    @property
    def size_px(self) -> tuple[int, int]:
        """(width, height)."""
        return self.width_px, self.height_px

    @cached_property
    def focal_px(self) -> FloatArray:
        """(2,) pixels per unit tangent in u and v, both positive."""
        size = np.array([self.width_px, self.height_px])
        return read_only(size / (self.tangent_max - self.tangent_min))

    @cached_property
    def centre_px(self) -> FloatArray:
        """(2,) principal point (tangents 0, 0), in pixels; may lie outside the image."""
        focal = self.focal_px
        return read_only(np.array([-self.tangent_min[0] * focal[0], self.tangent_max[1] * focal[1]]))

    @cached_property
    def image_from_camera(self) -> FloatArray:
        """Matrix (3, 4) from camera-frame points (x, y, z, 1) to (u depth, v depth, depth), in pixels and metres."""
        (focal_u, focal_v), (centre_u, centre_v) = self.focal_px, self.centre_px
        return read_only(np.array([[focal_u, 0, -centre_u, 0], [0, -focal_v, -centre_v, 0], [0, 0, -1, 0]]))

    @cached_property
    def camera_from_image(self) -> FloatArray:
        """Matrix (3, 3) from pixels (u, v, 1) to directions in the camera frame, scaled to z = -1."""
        (focal_u, focal_v), (centre_u, centre_v) = self.focal_px, self.centre_px
        rows = [[1 / focal_u, 0, -centre_u / focal_u], [0, -1 / focal_v, centre_v / focal_v], [0, 0, -1]]
        return read_only(np.array(rows))

    def pixel_of_tangents(self, tangents: FloatArray) -> FloatArray:
        """Return the pixels (..., 2) of tangents (..., 2); v runs down, ty up."""
        return np.asarray(tangents * (self.focal_px * [1, -1]) + self.centre_px)

    def tangents_of_pixel(self, pixel: FloatArray) -> FloatArray:
        """Return the tangents (..., 2) of pixels (..., 2); the inverse of `pixel_of_tangents`."""
        return np.asarray((pixel - self.centre_px) / (self.focal_px * [1, -1]))

    def contains(self, pixel: FloatArray | Float32Array) -> BoolArray:
        """Return whether pixels (..., 2) lie in the image; NaN does not."""
        return np.asarray(((pixel >= 0) & (pixel <= self.size_px)).all(axis=-1))

    def pixel_centre_tangents(self) -> FloatArray:
        """Return the tangents at all pixel centres, (height, width, 2)."""
        u, v = np.meshgrid(np.arange(self.width_px) + 0.5, np.arange(self.height_px) + 0.5)
        return self.tangents_of_pixel(np.stack([u, v], axis=-1))


def pixels_from(source: Pinhole, target: Pinhole) -> tuple[float, float, float, float]:
    """Return the scale (u, v) and offset (u, v) from pixels of `source` to pixels of `target`, in the same frame."""
    scale_u, scale_v = target.focal_px / source.focal_px
    offset_u, offset_v = target.centre_px - [scale_u, scale_v] * source.centre_px
    return float(scale_u), float(scale_v), float(offset_u), float(offset_v)
