"""Contrast of the bits of a Gray code in its photographs."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from wlr_render.captures.decoded import DEFAULT_OPTIONS, DecodeOptions
from wlr_render.captures.patterns.pattern import Pattern
from wlr_render.captures.patterns.photometry import INVERSE, Grey, PhotographReader, read_light
from wlr_render.captures.photographs import CodeImage

WEAK = 0.5
"""Median strength, relative to full contrast, below which a bit is weak."""
_WELL_LIT = 0.25  # contrast of well-lit pixels relative to the 95th percentile


@dataclass(frozen=True)
class BitStrength:
    """|picture - inverse| / (white - black) of one bit over well-lit camera pixels.

    Even a perfect bit is faint in pixels on the borders of its stripes: few pixels of a coarse bit, many of a fine one.

    Attributes:
        name: name of the bit's picture in the pattern, e.g. "u bit 3".
        median, percentile_5, percentile_1: statistics of the strength; 1 is full contrast.
        unsure_share: share of pixels whose strength is below the confidence that decoding requires.
    """

    name: str
    median: float
    percentile_5: float
    percentile_1: float
    unsure_share: float

    @property
    def weak(self) -> bool:
        """True if the bit is blurred or dimmed where there is enough light."""
        return self.median < WEAK


def bit_strengths(
    photographs: Iterable[CodeImage | None], pattern: Pattern, options: DecodeOptions = DEFAULT_OPTIONS
) -> tuple[BitStrength, ...]:
    """Measure the contrast of each bit that is followed by its inverse; arguments as for `pattern.decode`.

    Raises:
        BadInputError: photographs are missing or left over, of different sizes, or under- or over-exposed.
    """
    names = pattern.names()
    reader = PhotographReader(photographs, names)
    light = read_light(reader, options)
    well_lit = light.lit & (light.contrast >= _WELL_LIT * np.percentile(light.contrast[light.lit], 95))
    full = light.contrast[well_lit]
    strengths = []
    earlier: Grey | None = light.middle
    for number, name in enumerate(names[2:], start=2):
        image = reader.take()
        if name == names[number - 1] + INVERSE and image is not None and earlier is not None:
            strength = np.abs(image - earlier)[well_lit] / full
            strengths.append(_judged(names[number - 1], strength, options.min_confidence))
        earlier = image
    reader.finish()
    return tuple(strengths)


def _judged(name: str, strength: Grey, min_confidence: float) -> BitStrength:
    first, fifth, median = (float(value) for value in np.percentile(strength, (1, 5, 50)))
    return BitStrength(name, median, fifth, first, float(np.mean(strength < min_confidence)))
