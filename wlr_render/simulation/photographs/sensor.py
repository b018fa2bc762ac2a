"""The sensor of a photograph: from light to grey values."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wlr_render.captures.photographs import Photograph
from wlr_render.errors import BadInputError


@dataclass(frozen=True)
class Sensor:
    """A grey sensor with shot noise and read noise.

    Attributes:
        bits: of a grey value, 1 to 16; up to 8 are stored as uint8, more as uint16.
        exposure: by which light is multiplied; 1 is then full scale.
        full_well_e: electrons at full scale.
        read_noise_e: standard deviation, electrons.
        vignetting: part of the light that is lost in the corners; it grows with the square of the distance from the
            middle.
        gamma: grey values are the signal to the power of 1 / gamma.

    Raises:
        BadInputError: a value that no sensor has.
    """

    bits: int = 8
    exposure: float = 1.0
    full_well_e: float = 20_000.0
    read_noise_e: float = 5.0
    vignetting: float = 0.0
    gamma: float = 1.0

    def __post_init__(self) -> None:
        positive = min(self.exposure, self.full_well_e, self.gamma) > 0.0
        if not (1 <= self.bits <= 16 and positive and self.read_noise_e >= 0.0 and 0.0 <= self.vignetting <= 1.0):
            raise BadInputError(
                f"{self} cannot be; give 1 to 16 bits, a positive exposure, full well and gamma, a read noise of 0 or "
                "more, and vignetting between 0 and 1."
            )

    @classmethod
    def with_snr(
        cls, snr: float, bits: int = 8, exposure: float = 1.0, read_noise_e: float = 5.0, vignetting: float = 0.0
    ) -> "Sensor":
        """The sensor whose full well gives light 1 in the middle of the picture this ratio of signal to noise.

        The signal of N electrons has the noise sqrt(N + read noise^2); quantisation is not counted.
        """
        electrons = 0.5 * snr * (snr + float(np.hypot(snr, 2.0 * read_noise_e)))
        return cls(bits, exposure, electrons / exposure, read_noise_e, vignetting)

    def expose(self, light: NDArray[np.floating], rng: np.random.Generator) -> Photograph:
        """Photograph light (h, w), 0 and more, linear.

        Shot noise is drawn from the normal distribution of the same variance as Poisson's.
        """
        signal = light * self._falloff(light.shape) * self.exposure
        noise_e = np.sqrt(signal * self.full_well_e + self.read_noise_e**2)
        signal += rng.standard_normal(light.shape, dtype=np.float32) * noise_e / self.full_well_e
        grey = np.clip(signal, 0.0, 1.0) ** (1.0 / self.gamma) * (2**self.bits - 1)
        return np.asarray(np.rint(grey), dtype=np.uint8 if self.bits <= 8 else np.uint16)

    def _falloff(self, shape: tuple[int, ...]) -> NDArray[np.float32]:
        """What is left of the light in each pixel, (h, w)."""
        height, width = shape
        x = (np.arange(width, dtype=np.float32) + 0.5) / width - 0.5
        y = (np.arange(height, dtype=np.float32) + 0.5) / height - 0.5
        corner = np.float32(0.25 * (width**2 + height**2))
        from_middle = ((width * x) ** 2 + (height * y[:, None]) ** 2) / corner
        return np.asarray(np.float32(1.0) - np.float32(self.vignetting) * from_middle)
