"""A lens with a smooth residual field: what the terms of its model leave of the true distortion."""

from dataclasses import dataclass, replace

import numpy as np

from wlr_render.geometry.lens import Projection
from wlr_render.geometry.lens_camera import LensCamera
from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.smooth_field import SmoothField

_ROUNDS = 6  # of the inverse: the field's slope is below 0.01, so that each leaves a hundredth of the error


@dataclass(frozen=True, eq=False)
class CorrectedLens:
    """A lens whose pixels are displaced by a smooth field over the picture.

    Attributes:
        base: the lens without the field.
        field: waves over the picture, by the pixels of `base`.
        displacement: (2, k) pixels in u and v by each wave.
    """

    base: LensCamera
    field: SmoothField
    displacement: FloatArray

    @classmethod
    def of(cls, lens: LensCamera, most: int) -> "CorrectedLens":
        """Return the lens with a field of zero, of at most this many half waves along the longer side."""
        size = np.array(lens.size_px, dtype=np.float64)
        field = SmoothField.over(np.zeros(2), size, 1.15 * float(size.max()) / most, most)
        return cls(lens, field, np.zeros((2, len(field))))

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height."""
        return self.base.size_px

    @property
    def focal_px(self) -> FloatArray:
        """(2,) focal lengths of the base lens."""
        return self.base.focal_px

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the P parameters: of the base lens, and of the field."""
        return (*self.base.names, *(f"{axis}{k}" for axis in "uv" for k in range(len(self.field))))

    @property
    def values(self) -> FloatArray:
        """Values (P,) of the parameters."""
        return np.concatenate([self.base.values, self.displacement.ravel()])

    def with_values(self, values: FloatArray) -> "CorrectedLens":
        """Copy of this lens with other values (P,) of its parameters."""
        count = len(self.base.values)
        displacement = values[count:].reshape(self.displacement.shape)
        return replace(self, base=self.base.with_values(values[:count]), displacement=displacement)

    def project(self, point_in_camera: FloatArray) -> Projection:
        """Project points (n, 3), with derivatives by the points and by `values`."""
        seen = self.base.project(point_in_camera)
        pixel = np.nan_to_num(seen.pixel)
        waves = self.field.waves(pixel)
        slope = np.eye(2) + np.einsum("uk,nkv->nuv", self.displacement, self.field.slopes(pixel))
        by_field = np.kron(np.eye(2), waves[:, None]).reshape(len(pixel), 2, -1)
        by_values = np.concatenate([slope @ seen.by_values, by_field], axis=-1)
        return Projection(seen.pixel + waves @ self.displacement.T, slope @ seen.by_point, by_values)

    def pixel_of_point(self, point_in_camera: FloatArray) -> FloatArray:
        """Project points (..., 3) to pixels (..., 2); NaN for points that the model cannot see."""
        pixel = self.base.pixel_of_point(point_in_camera)
        return pixel + self._displaced(pixel)

    def dir_of_pixel(self, pixel: FloatArray) -> FloatArray:
        """Return the unit directions (..., 3) of pixels (..., 2), camera frame; NaN where distortion has no inverse."""
        return self.base.dir_of_pixel(self._of_base(pixel))

    def tangents_of_pixel(self, pixel: FloatArray) -> FloatArray:
        """Return the tangents (..., 2) of pixels (..., 2); NaN where the distortion has no inverse."""
        return self.base.tangents_of_pixel(self._of_base(pixel))

    def _of_base(self, pixel: FloatArray) -> FloatArray:
        """Return the pixels (..., 2) of the base lens."""
        found = np.asarray(pixel, dtype=np.float64)
        for _ in range(_ROUNDS):
            found = pixel - self._displaced(found)
        return found

    def _displaced(self, pixel: FloatArray) -> FloatArray:
        """Return the displacements (..., 2) at pixels (..., 2) of the base lens."""
        flat = np.nan_to_num(np.reshape(pixel, (-1, 2)))
        return np.asarray((self.field.waves(flat) @ self.displacement.T).reshape(np.shape(pixel)))
