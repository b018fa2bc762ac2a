"""Simulated camera: a lens with a finite pupil, and a grey sensor with shot and read noise.

Camera frame: OpenCV's axes (x right, y down, z forward), origin in the middle of the entrance pupil, metres.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy
from numpy.typing import NDArray

from wlr_render.captures.photographs import Photograph
from wlr_render.errors import BadInputError
from wlr_render.geometry import rays
from wlr_render.geometry.directions import normalised
from wlr_render.lenses.lens_camera import LensCamera
from wlr_render.numerics.arrays import FloatArray
from wlr_render.simulation.workshop import Workshop

_CANDIDATES = 2000  # candidate sample sets; the most uniform one is used


@dataclass(frozen=True, eq=False)
class SimulatedLens:
    """A camera with an entrance pupil of finite size, which is sharp in only one plane.

    Attributes:
        camera: projection of the rays through the middle of the pupil.
        pupil_diameter_m: diameter of the entrance pupil; 0 for a pinhole.
        focus_m: depth of the plane in focus; infinite for a lens set to infinity.
        workshop: errors of the second family, i.e. a residual distortion and a pupil that moves with the field angle;
            None without.

    Raises:
        BadInputError: a negative pupil, or a focus that is not in front of the lens.
    """

    camera: LensCamera
    pupil_diameter_m: float = 0.002
    focus_m: float = float("inf")
    workshop: Workshop | None = None

    def __post_init__(self) -> None:
        if not (0.0 <= self.pupil_diameter_m < np.inf and self.focus_m > 0.0):
            raise BadInputError(
                f"A lens of {self.pupil_diameter_m} m pupil diameter focused at {self.focus_m} m is impossible; give a "
                "diameter of 0 or more and a positive focus (inf for infinity)."
            )

    def ray_of_pixel(self, pixel: FloatArray, pupil_point: FloatArray) -> FloatArray:
        """Return the rays (..., 6) of image points, camera frame, from the pupil outwards.

        All rays of an image point meet where the ray through the middle of the pupil crosses the plane in focus.

        Args:
            pixel: (..., 2) image points, pixels.
            pupil_point: (2,) x and y of the point in the pupil, metres.
        """
        origin = np.array([*pupil_point, 0.0])
        if self.workshop is not None:
            size = np.array(self.camera.size_px)
            unit = (pixel - 0.5 * size) / (0.5 * np.linalg.norm(size))
            pixel = pixel + self.workshop.lens_px(unit)
            origin = origin + self.workshop.pupil_m(unit)[..., None] * [0.0, 0.0, 1.0]
        tangents = self.camera.tangents_of_pixel(pixel) - np.asarray(pupil_point) / self.focus_m
        forward = np.concatenate([tangents, np.ones((*tangents.shape[:-1], 1))], axis=-1)
        return rays.pack(origin, normalised(forward))

    def samples(self, count: int) -> tuple[FloatArray, FloatArray]:
        """Return the samples in pixel and pupil, which are the same for all pixels.

        Both sets are exactly centred, so that the number of samples does not shift the picture.

        Returns:
            Offsets from a pixel's centre (count, 2) in pixels, and the pupil points (count, 2) in metres.
        """
        unit = _even_samples(count)
        return unit[:, :2].copy(), 0.5 * self.pupil_diameter_m * _disc_of_square(2.0 * unit[:, 2:])


@lru_cache
def _even_samples(count: int) -> FloatArray:
    """Return points (count, 4) in the cube -0.5..0.5, symmetric about 0 and stratified along every axis.

    The result is the Latin hypercube with the least centred discrepancy among many: F. J. Hickernell, "A generalized
    discrepancy and quadrature error bound", Math. Comp. 67 (1998) 299.
    """
    if count < 1:
        raise BadInputError(f"{count} samples per pixel make no picture; give 1 or more.")
    rng = np.random.default_rng(0)
    half, odd = divmod(count, 2)
    levels = (np.arange(half) + 0.5 * (1 + odd)) / count
    shape = (_CANDIDATES if count <= 32 else _CANDIDATES // 20, half, 4)
    one_side = rng.permuted(np.broadcast_to(levels[:, None], shape), axis=1) * rng.choice([-1.0, 1.0], shape)
    sets = np.concatenate([one_side, np.zeros((shape[0], odd, 4)), -one_side], axis=1)
    return np.asarray(min(sets, key=lambda points: scipy.stats.qmc.discrepancy(points + 0.5)))


def _disc_of_square(square: FloatArray) -> FloatArray:
    """Map points (n, 2) of the square -1..1 to the unit disc, preserving relative areas.

    P. Shirley and K. Chiu, "A low distortion map between disk and square", J. Graphics Tools 2 (1997) 45.
    """
    x, y = square.T
    wide = np.abs(x) >= np.abs(y)
    radius = np.where(wide, x, y)
    with np.errstate(divide="ignore", invalid="ignore"):
        angle = np.where(wide, np.pi / 4 * y / x, np.pi / 2 - np.pi / 4 * x / y)
    angle = np.nan_to_num(angle)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)


@dataclass(frozen=True)
class Sensor:
    """A grey sensor with shot noise and read noise.

    Attributes:
        bits: bits of a grey value, 1 to 16; up to 8 are stored as uint8, more as uint16.
        exposure: factor on the light; full scale is then 1.
        full_well_e: electrons at full scale.
        read_noise_e: standard deviation, electrons.
        vignetting: fraction of light lost in the corners; the loss grows with the square of the distance from the
            middle.
        gamma: grey values are the signal to the power of 1 / gamma.
        black_clip: share of full scale subtracted from the signal, as by a black level that is too low; dark pixels are
            clipped to 0.

    Raises:
        BadInputError: a value is impossible for a sensor.
    """

    bits: int = 8
    exposure: float = 1.0
    full_well_e: float = 20_000.0
    read_noise_e: float = 5.0
    vignetting: float = 0.0
    gamma: float = 1.0
    black_clip: float = 0.0

    def __post_init__(self) -> None:
        positive = min(self.exposure, self.full_well_e, self.gamma) > 0.0
        parts = 0.0 <= self.vignetting <= 1.0 and 0.0 <= self.black_clip < 1.0
        if not (1 <= self.bits <= 16 and positive and self.read_noise_e >= 0.0 and parts):
            raise BadInputError(
                f"{self} is impossible; give 1 to 16 bits, a positive exposure, full well and gamma, a read noise of 0 "
                "or more, vignetting between 0 and 1, and a black_clip below 1."
            )

    @classmethod
    def with_snr(
        cls, snr: float, bits: int = 8, exposure: float = 1.0, read_noise_e: float = 5.0, vignetting: float = 0.0
    ) -> "Sensor":
        """Return a sensor with signal-to-noise ratio `snr` for light 1 in the middle of the picture.

        A signal of N electrons has the noise sqrt(N + read noise^2); quantisation is neglected.
        """
        electrons = 0.5 * snr * (snr + float(np.hypot(snr, 2.0 * read_noise_e)))
        return cls(bits, exposure, electrons / exposure, read_noise_e, vignetting)

    def expose(self, light: NDArray[np.floating], rng: np.random.Generator) -> Photograph:
        """Return the grey values for linear light (h, w), 0 or more.

        Shot noise has a normal distribution with the variance of the Poisson distribution.
        """
        signal = light * self._falloff(light.shape) * self.exposure
        noise_e = np.sqrt(signal * self.full_well_e + self.read_noise_e**2)
        signal += rng.standard_normal(light.shape, dtype=np.float32) * noise_e / self.full_well_e
        grey = np.clip(signal - np.float32(self.black_clip), 0.0, 1.0) ** (1.0 / self.gamma) * (2**self.bits - 1)
        return np.asarray(np.rint(grey), dtype=np.uint8 if self.bits <= 8 else np.uint16)

    def _falloff(self, shape: tuple[int, ...]) -> NDArray[np.float32]:
        """Return the fraction (h, w) of light that vignetting leaves at each pixel."""
        height, width = shape
        x = (np.arange(width, dtype=np.float32) + 0.5) / width - 0.5
        y = (np.arange(height, dtype=np.float32) + 0.5) / height - 0.5
        corner = np.float32(0.25 * (width**2 + height**2))
        from_middle = ((width * x) ** 2 + (height * y[:, None]) ** 2) / corner
        return np.asarray(np.float32(1.0) - np.float32(self.vignetting) * from_middle)
