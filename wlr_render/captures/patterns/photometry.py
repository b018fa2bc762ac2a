"""Reader of a set's photographs, the panel's light in each camera pixel from white and black, and the set's noise."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from wlr_render.captures.decoded import DecodeOptions
from wlr_render.captures.photographs import CodeImage, describe_pixels
from wlr_render.errors import BadInputError

Grey = NDArray[np.float32]

INVERSE = " inverse"
"""Suffix of the name of a bit's inverse picture."""
_CLEAR = 4.0  # least contrast of a lit pixel, in standard deviations
_BEYOND = 0.05  # largest number of pixels out of range, relative to the lit ones
_BOTH_WAYS = 0.2  # ratio of areas where white or black is brighter, above which both are pictures of the code
_STEADY_PX = 5  # width of windows whose mean has little noise
_NOISE_WINDOW = 15  # side of windows over which noise is averaged, which gives its sigma to 5 %
_ROUNDING = 2 / 12  # variance of the difference of two rounded values


class PhotographReader:
    """Reader of the photographs of a set, one at a time and in order; all have the same size.

    Photographs are numbered from 0, like `Pattern.image` and the files of `show_page`.
    """

    def __init__(self, photographs: Iterable[CodeImage | None], names: Sequence[str]) -> None:
        self._source = iter(photographs)
        self._waiting: list[CodeImage | None] = []
        self._names = names
        self._peak: CodeImage | None = None
        self.taken = 0

    @property
    def peak(self) -> CodeImage:
        """Maximum (h, w) of all photographs so far."""
        if self._peak is None:
            raise ValueError("no photograph was taken yet")
        return self._peak

    def label(self, index: int) -> str:
        """Return the name of a photograph for messages, such as photograph 12 ('u bit 5')."""
        return f"photograph {index} ('{self._names[index]}')"

    def take(self) -> Grey | None:
        """Return the next photograph, (h, w) float32 grey values; None for a missing one.

        Raises:
            BadInputError: no photograph is left, or it has another size or depth than the previous ones.
        """
        label = self.label(self.taken)
        image = self._next(label)
        self.taken += 1
        return None if image is None else image.astype(np.float32)

    def references(self) -> tuple[Grey, Grey]:
        """Return white and black, the first two photographs; a missing one is calculated from a bit and its inverse.

        Raises:
            BadInputError: both are missing, or no bit with its inverse follows.
        """
        first = [self.take(), self.take()]
        if first[0] is not None and first[1] is not None:
            return first[0], first[1]
        missing = next(number for number in (0, 1) if first[number] is None)
        given = first[1 - missing]
        names = self._names[2:4]
        paired = len(names) == 2 and names[1] == names[0] + INVERSE
        pair = [self._next(self.label(2 + number)) for number in (0, 1)] if paired else []
        self._waiting = list(pair)
        if given is None or len(pair) < 2 or pair[0] is None or pair[1] is None:
            raise BadInputError(
                f"{self.label(missing)} is missing, and no bit with its inverse replaces it; take it again."
            )
        replacement = np.add(pair[0], pair[1], dtype=np.float32) - given
        return (replacement, given) if missing == 0 else (given, replacement)

    def _next(self, label: str) -> CodeImage | None:
        if self._waiting:
            return self._waiting.pop(0)
        try:
            image = next(self._source)
        except StopIteration:
            raise BadInputError(
                f"{label} is missing: there are {self.taken} photographs for {len(self._names)} pictures shown."
            ) from None
        if image is None:
            return None
        if self._peak is None:
            self._peak = _grey_values(image, label).copy()
        elif image.shape != self._peak.shape or image.dtype != self._peak.dtype:
            raise BadInputError(
                f"{label} is {describe_pixels(image)}, but the previous ones are {describe_pixels(self._peak)}; "
                "take it again."
            )
        np.maximum(self._peak, image, out=self._peak)
        return image

    def finish(self) -> None:
        """Refuse further photographs.

        Raises:
            BadInputError: a further photograph follows.
        """
        if next(self._source, None) is not None:
            raise BadInputError(
                f"There are more photographs than the {len(self._names)} pictures shown; the last should be "
                f"{self.label(len(self._names) - 1)}."
            )


def _grey_values(image: CodeImage, label: str) -> CodeImage:
    if image.ndim != 2 or image.dtype not in (np.uint8, np.uint16, np.float32):
        raise BadInputError(
            f"{label} must be a grey picture of 8 or 16 bits, not {image.dtype} of shape {image.shape}."
        )
    return image


@dataclass(frozen=True, eq=False)
class PanelContrast:
    """Contrast of the panel in each camera pixel; ambient light is in both references and cancels.

    Attributes:
        middle: (h, w) half of white + black.
        contrast: (h, w) white - black.
        lit: (h, w) mask of sufficient contrast, with white below the end of the scale.
        end_of_scale: grey value from which a photograph may be saturated.
    """

    middle: Grey
    contrast: Grey
    lit: NDArray[np.bool_]
    end_of_scale: float

    @cached_property
    def usual_contrast(self) -> float:
        """Median of the contrast over the lit pixels."""
        return float(np.median(self.contrast[self.lit]))

    @cached_property
    def per_contrast(self) -> Grey:
        """Inverse contrast (h, w) where lit, 0 elsewhere."""
        return np.asarray(self.lit / np.maximum(self.contrast, 1), dtype=np.float32)


def read_light(reader: PhotographReader, options: DecodeOptions) -> PanelContrast:
    """Measure the panel's light from white and black, the first two photographs of every set.

    Raises:
        BadInputError: white is not brighter than black anywhere, black is brighter than white, or most lit pixels are
            at the end of the scale.
    """
    white, black = reader.references()
    contrast = white - black
    enough = options.min_contrast * options.full_scale
    end_of_scale = options.full_scale if options.end_of_scale is None else options.end_of_scale
    full = white >= end_of_scale
    bright = contrast >= max(enough, _CLEAR * _noise_of_dark(contrast))
    steady = cv2.blur(contrast, (_STEADY_PX, _STEADY_PX))
    brighter, darker = (float(np.mean(sign * steady >= enough)) for sign in (1, -1))
    if min(brighter, darker) > _BOTH_WAYS * max(brighter, darker):
        raise BadInputError(
            f"{reader.label(0)} is brighter than {reader.label(1)} in {brighter:.0%} of the picture and darker in "
            f"{darker:.0%}, so they do not show white and black: OpenCV's Gray code shows these last (order = "
            '"opencv", --order opencv); or the photographs are out of order.'
        )
    if np.count_nonzero(contrast <= -enough) > 2 * np.count_nonzero(contrast >= enough):
        raise BadInputError(
            f"{reader.label(0)} is darker than {reader.label(1)}: the two seem to be exchanged, or each photograph "
            "shows the picture before its own."
        )
    if np.count_nonzero(full) > 0.5 * np.count_nonzero(bright | full):
        raise BadInputError(
            f"{reader.label(0)} is over-exposed: {np.mean(full):.0%} of it is at the end of the scale "
            f"({options.full_scale}); expose less, or state the camera's true full scale."
        )
    # Single pixels are hot pixels or noise.
    if not np.any(cv2.medianBlur(bright.astype(np.uint8), 3)):
        raise BadInputError(
            f"{reader.label(0)} is nowhere brighter than {reader.label(1)} by {options.min_contrast:.0%} of the scale "
            f"({options.full_scale}): was the panel on, and the exposure long enough?"
        )
    return PanelContrast(0.5 * (white + black), contrast, bright & ~full, end_of_scale)


def _noise_of_dark(contrast: Grey) -> float:
    """Return the rms noise of unlit pixels, from negative contrasts, which only noise produces."""
    negative = contrast[contrast < 0]
    return float(np.sqrt(np.mean(negative**2))) if negative.size else 0.0


def check_range(image: Grey, light: PanelContrast, reader: PhotographReader) -> None:
    """Refuse the last photograph if it does not lie between black and white.

    Raises:
        BadInputError: too many pixels are out of range, because a reference shows something else or the light changed.
    """
    beyond = np.abs(image - light.middle) > 0.5 * (light.contrast + light.usual_contrast)
    pixels, lit = np.count_nonzero(beyond), np.count_nonzero(light.lit)
    if pixels > _BEYOND * lit:
        raise BadInputError(
            f"{reader.label(reader.taken - 1)} is brighter than {reader.label(0)} or darker than {reader.label(1)} in "
            f"{pixels} pixels, and the panel lights {lit}: one of them shows something else, or the light has changed."
        )


class NoiseMeter:
    """Running variance of the photographs' noise, from grey values that are equal without noise."""

    def __init__(self, light: PanelContrast) -> None:
        self._count, self._sum, self._square = (np.zeros(light.contrast.shape, dtype=np.float32) for _ in range(3))

    def add(self, steady: Grey, where: NDArray[np.bool_]) -> None:
        """Add grey values (h, w) in the mask (h, w), scaled to the variance of a difference of two photographs."""
        value = steady * where
        self._count += where
        self._sum += value
        self._square += value * value

    def variance(self) -> Grey:
        """Return the variance (h, w) of the difference of two photographs around each pixel, grey values squared.

        The result is at least the variance of the difference of two rounded values, also where few values were added.
        """
        excess = self._square - self._sum**2 / np.maximum(self._count, 1)
        freedom = np.maximum(self._count - 1, 0)
        excess, freedom = (
            cv2.boxFilter(image, -1, (_NOISE_WINDOW, _NOISE_WINDOW), normalize=False) for image in (excess, freedom)
        )
        return np.asarray(np.maximum(excess / np.maximum(freedom, 1), _ROUNDING), dtype=np.float32)
