"""How strongly each bit of a code comes through to the camera. The finest stripes fade first."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from wlr_render.captures.patterns.pattern import DecodeOptions, Pattern
from wlr_render.captures.patterns.photometry import read_light
from wlr_render.captures.patterns.shots import Grey, Shots
from wlr_render.captures.photographs import Photograph

WEAK = 0.5
"""A bit is weak if its median strength is below this part of full contrast."""

_WELL_LIT = 0.25  # of the contrast that the brightest twentieth of the lit pixels exceeds
_INVERSE = " inverse"
_USUAL = DecodeOptions()


@dataclass(frozen=True)
class BitStrength:
    """|picture - inverse| / (white - black) of one bit over well-lit camera pixels.

    Even a faultless bit is faint in the pixels that see the border of its stripes: few of a coarse, many of a fine one.

    Attributes:
        name: as the pattern calls its picture, e.g. "u bit 3".
        median, percentile_5, percentile_1: of the strength; 1 is full contrast.
        unsure_share: of these pixels, where the strength is below the confidence that decoding asks for.
    """

    name: str
    median: float
    percentile_5: float
    percentile_1: float
    unsure_share: float

    @property
    def weak(self) -> bool:
        """Whether the bit is blurred or dimmed where there is light enough."""
        return self.median < WEAK


def bit_strengths(
    photographs: Iterable[Photograph], pattern: Pattern, options: DecodeOptions = _USUAL
) -> tuple[BitStrength, ...]:
    """Judge each bit that is shown with its inverse right after it; photographs as `pattern.decode` takes them.

    Raises:
        BadInputError: photographs are missing or left over, of different sizes, or under- or over-exposed.
    """
    names = pattern.names()
    shots = Shots(photographs, names)
    light = read_light(shots, options)
    well_lit = light.lit & (light.contrast >= _WELL_LIT * np.percentile(light.contrast[light.lit], 95))
    full = light.contrast[well_lit]
    strengths = []
    earlier = light.middle
    for number, name in enumerate(names[2:], start=2):
        image = shots.take()
        if name == names[number - 1] + _INVERSE:
            strength = np.abs(image - earlier)[well_lit] / full
            strengths.append(_judged(names[number - 1], strength, options.min_confidence))
        earlier = image
    shots.finish()
    return tuple(strengths)


def _judged(name: str, strength: Grey, min_confidence: float) -> BitStrength:
    first, fifth, median = (float(value) for value in np.percentile(strength, (1, 5, 50)))
    return BitStrength(name, median, fifth, first, float(np.mean(strength < min_confidence)))
