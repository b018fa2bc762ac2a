"""What white and black say about each camera pixel, and how large the noise of a set is."""

import math
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from wlr_render.captures.patterns.pattern import DecodeOptions
from wlr_render.captures.patterns.shots import Grey, Shots
from wlr_render.errors import BadInputError

_CLEAR = 4.0  # contrast over its noise, below which a pixel is not lit
_BEYOND = 0.05  # of the number of lit pixels
_NOISE_WINDOW = 15
_BETWEEN = 0.02  # of a warped picture, pixels on its rim
_ROUNDING = 2 / 12  # variance of the difference of two rounded values


@dataclass(frozen=True, eq=False)
class Light:
    """The panel's light in each camera pixel; ambient light is in both references and cancels.

    Attributes:
        middle: (h, w) half of white + black.
        contrast: (h, w) white - black.
        lit: (h, w) where the contrast is enough and white is not at the end of the scale.
        end_of_scale: the grey value from which on a photograph may be cut off.
    """

    middle: Grey
    contrast: Grey
    lit: NDArray[np.bool_]
    end_of_scale: float

    @cached_property
    def usual_contrast(self) -> float:
        """Median of the contrast over what is lit."""
        return float(np.median(self.contrast[self.lit]))

    @cached_property
    def per_contrast(self) -> Grey:
        """(h, w) 1 / contrast where lit, 0 elsewhere."""
        return np.asarray(self.lit / np.maximum(self.contrast, 1), dtype=np.float32)


def read_light(shots: Shots, options: DecodeOptions) -> Light:
    """Take white and black, the first two photographs of every set.

    Raises:
        BadInputError: white is not brighter than black anywhere, black is brighter than white, or most of what is lit
            is at the end of the scale.
    """
    white, black = shots.take(), shots.take()
    contrast = white - black
    enough = options.min_contrast * options.full_scale
    end_of_scale = math.inf if _never_photographed(white, black, options) else options.full_scale
    full = white >= end_of_scale
    bright = contrast >= max(enough, _CLEAR * _noise_of_dark(contrast))
    if np.count_nonzero(contrast <= -enough) > 2 * np.count_nonzero(contrast >= enough):
        raise BadInputError(f"{shots.label(0)} is darker than {shots.label(1)}: the two seem to be exchanged.")
    if np.count_nonzero(full) > 0.5 * np.count_nonzero(bright | full):
        raise BadInputError(
            f"{shots.label(0)} is over-exposed: {np.mean(full):.0%} of it is at the end of the scale "
            f"({options.full_scale}); expose less, or state the camera's true full scale."
        )
    if not np.any(bright):
        raise BadInputError(
            f"{shots.label(0)} is nowhere brighter than {shots.label(1)} by {options.min_contrast:.0%} of the scale "
            f"({options.full_scale}): was the panel on, and the exposure long enough?"
        )
    return Light(0.5 * (white + black), contrast, bright & ~full, end_of_scale)


def _noise_of_dark(contrast: Grey) -> float:
    """Standard deviation of what the panel does not light: only noise makes it negative."""
    negative = contrast[contrast < 0]
    return float(np.sqrt(np.mean(negative**2))) if negative.size else 0.0


def _never_photographed(white: Grey, black: Grey, options: DecodeOptions) -> bool:
    """Whether these are the pictures themselves, warped perhaps: no camera gives two values only, with no noise."""
    between = (white > 0) & (white < options.full_scale)
    return not np.any(black) and float(np.mean(between)) < _BETWEEN


def check_range(image: Grey, light: Light, shots: Shots) -> None:
    """See that the photograph just taken lies between black and white.

    Raises:
        BadInputError: in too many pixels it does not: a reference shows something else, or the light has changed.
    """
    beyond = np.abs(image - light.middle) > 0.5 * (light.contrast + light.usual_contrast)
    share = np.count_nonzero(beyond) / np.count_nonzero(light.lit)
    if share > _BEYOND:
        raise BadInputError(
            f"{shots.label(shots.taken - 1)} is brighter than {shots.label(0)} or darker than {shots.label(1)} in as "
            f"many pixels as {share:.0%} of the lit ones: one of them shows something else, or the light has changed."
        )


class NoiseMeter:
    """Variance of photographs, from sums that would all be equal without noise; running moments only."""

    def __init__(self, light: Light) -> None:
        self._count, self._sum, self._square = (np.zeros(light.contrast.shape, dtype=np.float32) for _ in range(3))

    def add(self, steady: Grey, where: NDArray[np.bool_]) -> None:
        """One more sum, scaled so that its variance is that of a difference of two photographs; (h, w) both."""
        value = steady * where
        self._count += where
        self._sum += value
        self._square += value * value

    def variance(self) -> Grey:
        """(h, w) variance of the difference of two photographs around each pixel, grey values squared.

        Never below that of two rounded values; just that where too few sums were added.
        """
        excess = self._square - self._sum**2 / np.maximum(self._count, 1)
        freedom = np.maximum(self._count - 1, 0)
        excess, freedom = (
            cv2.boxFilter(image, -1, (_NOISE_WINDOW, _NOISE_WINDOW), normalize=False) for image in (excess, freedom)
        )
        return np.asarray(np.maximum(excess / np.maximum(freedom, 1), _ROUNDING), dtype=np.float32)
