"""A lens model with residual distortion: a smooth field of displacements over the picture.

Source of the idea: T. Schoeps et al., "Why having 10,000 parameters in your camera model is better than twelve",
CVPR 2020. Models with few terms differ from real lenses by a systematic fraction of a pixel, as boards show.
"""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from wlr_render.lenses.lens import Projection
from wlr_render.lenses.lens_camera import LensCamera
from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.smooth_field import SmoothField

RESIDUAL = "residual"
"""Parameter name of the amplitudes."""
_WAVES = 9, 7  # half waves along the sides of the picture: finer residuals average out over a board
_FALL = 0.1  # decrease of log prior size per half wave: residuals are not smoother than the lens model
_STEP_PX = 1e-3  # step of the finite differences of the slope
_GRID = 25  # samples along each side for the field's rms
_ROUNDS, _CLOSE_PX = 8, 1e-3  # most steps of the inverse, last step: flat fields need 3, steep ones have no inverse


@dataclass(frozen=True, eq=False)
class ResidualLens:
    """A lens model with pixels displaced by a smooth field over the picture.

    Attributes:
        model: the lens model.
        residual_px: (waves, 2) amplitudes of the field's waves along u and v, pixels.
        counts: half waves of the field along both sides.
    """

    model: LensCamera
    residual_px: FloatArray
    counts: tuple[int, int] = _WAVES

    @classmethod
    def of(cls, model: LensCamera) -> "ResidualLens":
        """Return a lens without residual, for a fit."""
        return cls(model, np.zeros((_WAVES[0] * _WAVES[1], 2)))

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height."""
        return self.model.size_px

    @property
    def kind(self) -> str:
        """Kind of the lens model."""
        return self.model.kind

    @property
    def focal_px(self) -> FloatArray:
        """(2,) pixels per unit of the model's undistorted image in u and v, at its centre."""
        return self.model.focal_px

    @property
    def centre_px(self) -> FloatArray:
        """(2,) principal point of the model."""
        return self.model.centre_px

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the model's parameters, then `RESIDUAL` for each amplitude."""
        return (*self.model.names, *[RESIDUAL] * self.residual_px.size)

    @property
    def values(self) -> FloatArray:
        """Values (P,) of the model's parameters and the amplitudes, u and v of each wave in turn."""
        return np.concatenate([self.model.values, self.residual_px.ravel()])

    def with_values(self, values: FloatArray) -> "ResidualLens":
        """Return a copy of this lens with other values (P,) of its parameters."""
        count = len(self.model.values)
        return replace(self, model=self.model.with_values(values[:count]), residual_px=values[count:].reshape(-1, 2))

    @property
    def field(self) -> SmoothField:
        """The field over the picture."""
        return _field(self.size_px, self.counts)

    @property
    def rms_px(self) -> float:
        """Root mean square of the displacement over the picture, per axis."""
        places = np.stack(np.meshgrid(*(np.linspace(0.0, side, _GRID) for side in self.size_px)), axis=-1)
        return float(np.sqrt(np.mean(self._displacement(places) ** 2)))

    def project(self, point_in_camera: FloatArray) -> Projection:
        """Project points (n, 3), with derivatives."""
        plain = self.model.project(point_in_camera)
        waves = self.field.waves(plain.pixel)
        stretch = np.eye(2) + self._slope(plain.pixel)
        by_residual = np.zeros((len(waves), 2, self.residual_px.size))
        by_residual[:, 0, ::2] = by_residual[:, 1, 1::2] = waves
        return Projection(
            plain.pixel + waves @ self.residual_px,
            stretch @ plain.by_point,
            np.concatenate([stretch @ plain.by_values, by_residual], axis=-1),
        )

    def pixel_of_point(self, point_in_camera: FloatArray) -> FloatArray:
        """Project points (..., 3) to pixels (..., 2); NaN for points that the model cannot see."""
        pixel = self.model.pixel_of_point(point_in_camera)
        return pixel + self._displacement(pixel)

    def dir_of_pixel(self, pixel: FloatArray) -> FloatArray:
        """Return the unit directions (..., 3) of pixels (..., 2); NaN for pixels without a direction."""
        return self.model.dir_of_pixel(self._pixel_of_model(pixel))

    def tangents_of_pixel(self, pixel: FloatArray) -> FloatArray:
        """Return the tangents (..., 2), x / z and y / z, of pixels (..., 2); NaN for pixels without a direction."""
        return self.model.tangents_of_pixel(self._pixel_of_model(pixel))

    def _pixel_of_model(self, pixel: FloatArray) -> FloatArray:
        """Return the model's pixels (..., 2) that the field displaces to `pixel`."""
        pixel = np.asarray(pixel, dtype=np.float64)
        if not np.any(self.residual_px):
            return pixel
        before = found = pixel
        for _ in range(_ROUNDS):
            before, found = found, pixel - self._displacement(found)
        return np.where(np.abs(found - before) < _CLOSE_PX, found, np.nan)

    def _displacement(self, pixel: FloatArray) -> FloatArray:
        """Return the displacement (..., 2) in pixels at the model's pixels (..., 2)."""
        return (self.field.waves(pixel.reshape(-1, 2)) @ self.residual_px).reshape(pixel.shape)

    def _slope(self, pixel: FloatArray) -> FloatArray:
        """Return the derivative (n, 2, 2) of the displacement by the model's pixels (n, 2)."""
        if not np.any(self.residual_px):
            return np.zeros((len(pixel), 2, 2))
        steps = _STEP_PX * np.eye(2)[:, None]
        after, before = self._displacement(pixel + np.stack([steps, -steps]))
        return np.asarray(np.moveaxis(after - before, 0, -1) / (2.0 * _STEP_PX))


@lru_cache
def _field(size_px: tuple[int, int], counts: tuple[int, int]) -> SmoothField:
    """Return the field of a picture size, cached: a fit creates many lenses of one size."""
    width, height = size_px
    return SmoothField((0.0, 0.0), (float(width), float(height)), counts, _FALL)
