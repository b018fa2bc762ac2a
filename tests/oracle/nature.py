"""What every bench has besides hidden effects: positions that do not repeat, and noise that is not as stated."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from oracle.captures import CAMERA_CENTRE_PX
from oracle.own_tracer import FloatArray, turn

_WAVES = 256  # of the random field of one photograph


@dataclass(frozen=True)
class BenchNature:
    """Imperfections of an ordinary bench; the defaults are those of a perfect one.

    All random numbers are normal, independent per axis, and new in each capture.

    Attributes:
        repeatability_mm: sigma of the camera's position in each capture.
        turns_rad: sigma of the rotation vector by which the camera is turned in each capture.
        target_mm, target_rad: the same for each pose of the target, which turns about its middle.
        noise_factor: true sigma of a point over the stated one.
        rim_factor: sigma at the image's corners over that at its middle; it rises with the square of the radius.
        noisy_share: share of the captures of each table that are noisier; drawn at random.
        noisy_factor: how many times larger sigma is in these captures.
        shared: share of the noise's variance that neighbouring points of one photograph have in common.
        shared_spacings: spacings of the grid at which the correlation of that part falls to 0.61: it is
            exp(-(distance / length)^2 / 2). Each colour is a photograph of its own.
        t_dof: degrees of freedom of Student's t distribution of the rest, above 2; sigma stays as it is.
    """

    repeatability_mm: float = 0.0
    turns_rad: float = 0.0
    target_mm: float = 0.0
    target_rad: float = 0.0
    noise_factor: float = 1.0
    rim_factor: float = 1.0
    noisy_share: float = 0.0
    noisy_factor: float = 1.0
    shared: float = 0.0
    shared_spacings: float = 2.0
    t_dof: float = np.inf

    def camera_motion(self, captures: int, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
        """Shifts (c, 3) in millimetres and rotations (c, 3, 3) of the camera, device frame."""
        return _motion(self.repeatability_mm, self.turns_rad, captures, rng)

    def target_motion(self, poses: int, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
        """Shifts (p, 3) in millimetres and rotations (p, 3, 3) of the target, device frame."""
        return _motion(self.target_mm, self.target_rad, poses, rng)

    def noise(
        self,
        white: FloatArray,
        place: FloatArray,
        capture: NDArray[np.int64],
        photograph: NDArray[np.int64],
        spacing_px: float,
        rng: np.random.Generator,
    ) -> FloatArray:
        """Noise of points over the stated sigma, (n, 2).

        Args:
            white: (n, 2) normal noise of unit variance; this is what a perfect nature returns.
            place: (n, 2) the points' places in the camera's image.
            capture: (n,) to which capture each point belongs, from 0.
            photograph: (n,) the same for photographs, of which a capture has one for each colour.
            spacing_px: distance of neighbouring points.
            rng: of everything but the white noise.
        """
        noise = white
        if np.isfinite(self.t_dof):
            # Normal over the root of chi-squared over its degrees of freedom, scaled to the same variance.
            squares = rng.chisquare(self.t_dof, white.shape) / (self.t_dof - 2.0)
            noise = noise / np.sqrt(squares)
        if self.shared > 0.0:
            field = smooth_field(place, photograph, self.shared_spacings * spacing_px, rng)
            noise = np.sqrt(1.0 - self.shared) * noise + np.sqrt(self.shared) * field
        count = int(capture.max()) + 1
        larger = np.ones(count)
        larger[rng.permutation(count)[: round(self.noisy_share * count)]] = self.noisy_factor
        radius = np.linalg.norm(place - CAMERA_CENTRE_PX, axis=-1) / np.linalg.norm(CAMERA_CENTRE_PX)
        rise = 1.0 + (self.rim_factor - 1.0) * radius**2
        return np.asarray(noise * (self.noise_factor * larger[capture] * rise)[:, None])


PERFECT = BenchNature()
"""A bench without imperfections: its noise is white, and as stated."""


def smooth_field(
    place: FloatArray, photograph: NDArray[np.int64], length_px: float, rng: np.random.Generator
) -> FloatArray:
    """Values (n, 2) of two Gaussian random fields of unit variance in each photograph, by random waves.

    Their correlation is exp(-(distance / length)^2 / 2).
    """
    field = np.full(place.shape, np.nan)
    for number in np.unique(photograph):
        rows = photograph == number
        phase = place[rows] @ rng.normal(scale=1.0 / length_px, size=(2, _WAVES))
        waves = np.concatenate([np.cos(phase), np.sin(phase)], axis=-1)
        field[rows] = waves @ rng.normal(scale=1.0 / np.sqrt(_WAVES), size=(2 * _WAVES, 2))
    return field


def _motion(mm: float, rad: float, count: int, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    shift, vector = rng.normal(size=(2, count, 3))
    return mm * shift, turn(rad * vector)
