"""Gains of the panel's light from picture to picture of a set, estimated with repeated white photographs.

The white photographs give the drift of the light, by interpolation in time. A picture i and its inverse j give their
own gains: with the relative light r = (photograph - black) / (white - black), r_i / g_i + r_j / g_j = 1 at every pixel.
Least squares over many pixels finds both gains, with the drift as their prior, because a blurred pair, grey all over,
determines only their mean. Light from other sources, such as a lamp in the room, has no gain: a set in which it changes
the pixels that the panel does not light is refused, and so are whites whose gain varies across the picture.
"""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from wlr_render.captures.patterns.photometry import INVERSE
from wlr_render.captures.photographs import CodeImage
from wlr_render.errors import BadInputError
from wlr_render.numerics.arrays import BoolArray, FloatArray, IntArray

_PIXELS = 20_000  # number of well-lit pixels for the estimate of gains
_WELL_LIT = 0.5  # contrast of these pixels relative to the 95th percentile
_UNLIT, _LEAST_UNLIT = 0.03, 200  # contrast of unlit pixels, in the same unit, and least number to measure other light
_OTHER_LIGHT = 0.03  # largest change of other light over the contrast of well-lit pixels
_BLOCKS, _UNEVEN = 16, 0.03  # bands of rows or columns of the picture, and largest rms spread of the gain over them
_FLICKER = 0.1  # prior sigma of a picture's gain about the drift
_GREY = 0.02  # least sigma of a pixel's relative light: gamma, and light scattered from other pixels
_COUNTED = 100  # effective number of independent pixels; neighbours see the same stripe
_OUTLIER = 4.0  # outlier threshold, in robust standard deviations
_WHITE_AGAIN = "a white photograph taken again"


@dataclass(frozen=True, eq=False)
class LightGains:
    """Gains of the pictures of a set.

    Attributes:
        gain: (pictures,) light of each picture relative to the first white photograph.
        black: (h, w) the black photograph, to which gains do not apply.
        end_of_scale: value from which a pixel is saturated; it is not scaled.
        drift: (2,) least and largest gain of the white photographs.
        flicker: rms of the gains of pictures about the drift, relative; NaN without a picture with its inverse.
        unpaired: number of pictures, besides white and black, with unknown flicker, which is not corrected.
    """

    gain: FloatArray
    black: FloatArray
    end_of_scale: float
    drift: tuple[float, float]
    flicker: float
    unpaired: int

    def repaired(self, number: int, image: CodeImage) -> CodeImage:
        """Return picture `number` (h, w), float32, scaled to the light of the first white photograph."""
        steady = self.black + (image - self.black) / self.gain[number]
        saturated = image >= self.end_of_scale
        # A scaled pixel must not look saturated, and a saturated one must stay saturated.
        steady = np.where(saturated, self.end_of_scale, np.minimum(steady, np.nextafter(self.end_of_scale, 0.0)))
        return np.asarray(steady, dtype=np.float32)

    @property
    def note(self) -> str:
        """Sentence about the drift and flicker that were corrected, and about uncorrected flicker."""
        low, high = (100.0 * (each - 1.0) for each in self.drift)
        said = f"White photographs taken again differ by {low:+.1f} to {high:+.1f} % from the first"
        said += "" if np.isnan(self.flicker) else f", and the light flickers by {100 * self.flicker:.1f} % rms"
        rest = f"; the flicker of {self.unpaired} pictures without an inverse stays" if self.unpaired else ""
        return f"{said}: the pictures were scaled to one light{rest}. The noise that remains is in the sigmas."


@dataclass(frozen=True, eq=False)
class _Panel:
    """The first black photograph, the contrast of white and black, and the lit and unlit pixels.

    Attributes:
        black, contrast: (h, w) black, and white - black.
        bright: 95th percentile of the contrast.
        rows: (n,) flat indices of well-lit pixels.
        unlit: (h, w) pixels that the panel does not light.
    """

    black: FloatArray
    contrast: FloatArray
    bright: float
    rows: IntArray
    unlit: BoolArray

    @classmethod
    def of(cls, white: CodeImage, black: CodeImage, end_of_scale: float) -> "_Panel":
        """Return the panel from its first white and black; `BadInputError` if the panel was off."""
        contrast = white.astype(np.float64) - black
        bright = float(np.percentile(contrast, 95))
        lit = (contrast > _WELL_LIT * bright) & (contrast > 0) & (white < end_of_scale)
        rows = np.flatnonzero(lit)[:: max(1, int(np.count_nonzero(lit)) // _PIXELS)]
        if not rows.size:
            raise BadInputError("white is nowhere brighter than black; was the panel on?")
        return cls(black.astype(np.float64), contrast, bright, rows, np.abs(contrast) < _UNLIT * bright)

    def relative(self, image: CodeImage, name: str) -> FloatArray:
        """Return the light (n,) of a picture at well-lit pixels, relative to the first white and black."""
        if image.shape != self.contrast.shape:
            raise BadInputError(
                f"a photograph has {image.shape} pixels, the first one {self.contrast.shape}; take it again."
            )
        change = image - self.black
        light = change.ravel()[self.rows] / self.contrast.ravel()[self.rows]
        if name == _WHITE_AGAIN and np.median(light) <= 0:
            raise BadInputError(f"{name} is no brighter than black; take it again, or leave it out.")
        if np.count_nonzero(self.unlit) >= _LEAST_UNLIT:
            self._require_dark_room(change[self.unlit], name)
        return np.asarray(light)

    def _require_dark_room(self, change: FloatArray, name: str) -> None:
        """Refuse a picture whose `change` from black at unlit pixels is more than scattered light explains."""
        low, high = np.sort([0.0, np.median(self.contrast[self.unlit])])
        now = float(np.median(change))
        excess = (now - float(np.clip(now, low, high))) / self.bright
        if abs(excess) > _OTHER_LIGHT:
            raise BadInputError(
                f"{name} is {abs(excess):.0%} of white {'brighter' if excess > 0 else 'darker'} than 'black' where the "
                "panel lights nothing: other light has changed, which is not repaired; take the set again in a dark "
                "room."
            )


def light_gains(
    pictures: Iterable[CodeImage | None],
    whites: Iterable[CodeImage],
    names: Sequence[str],
    taken: IntArray,
    taken_white: IntArray,
    end_of_scale: float,
) -> LightGains:
    """Find the gain of each picture of a set.

    Args:
        pictures: photographs of the pictures; None for a missing one. whites: further photographs of white.
        names: names of the pictures.
        taken: (pictures,) positions of the pictures in the order of taking; -1 for a missing one.
        taken_white: (whites,) positions of `whites` in this order.
        end_of_scale: value from which a pixel is saturated.

    Raises:
        BadInputError: the first white or black is missing, a photograph has another size, the panel was off in one, or
            the light changed in a way that gains do not describe.
    """
    source = iter(pictures)
    white, black = next(source), next(source)
    if white is None or black is None:
        raise BadInputError("white photographs taken again need the first white and black; take these again.")
    panel = _Panel.of(white, black, end_of_scale)
    again = [panel.relative(each, _WHITE_AGAIN) for each in whites]
    of_white = [float(np.median(each)) for each in again]
    for each, middle in zip(again, of_white, strict=True):
        _require_even(each / middle, np.unravel_index(panel.rows, white.shape))
    light = [np.ones(panel.rows.size), np.zeros(panel.rows.size)]
    light += [
        np.full(panel.rows.size, np.nan) if each is None else panel.relative(each, f"photograph '{name}'")
        for each, name in zip(source, names[2:], strict=True)
    ]
    drift = _drift(np.append(taken[0], taken_white), np.append(1.0, of_white), taken)
    gain, known = drift.copy(), np.zeros(len(names), dtype=bool)
    for one, other in inverse_pairs(names):
        if taken[one] >= 0 and taken[other] >= 0:
            both = [one, other]
            gain[both], known[both] = _of_pair(light[one], light[other], drift[both]), True
    gain[:2] = 1.0
    flicker = float(np.sqrt(np.mean(np.log(gain[known] / drift[known]) ** 2))) if known.any() else np.nan
    unpaired = int(np.sum(~known[2:] & (taken[2:] >= 0)))
    ends = min(of_white + [1.0]), max(of_white + [1.0])
    return LightGains(gain, panel.black, end_of_scale, ends, flicker, unpaired)


def _require_even(gain: FloatArray, place: tuple[IntArray, ...]) -> None:
    """Refuse relative gains (n,), at rows and columns `place` of the picture, that differ from band to band."""
    for along in place:
        band = along * _BLOCKS // (int(along.max()) + 1)
        middle = [float(np.median(gain[band == number])) for number in np.unique(band)]
        if (spread := float(np.std(middle))) > _UNEVEN:
            raise BadInputError(
                f"{_WHITE_AGAIN} differs from the first by a light that changes by {spread:.0%} rms across the "
                "picture, as bands of a rolling shutter do, which is not repaired; expose for whole periods of the "
                "flicker."
            )


def inverse_pairs(names: Sequence[str]) -> list[tuple[int, int]]:
    """Return the numbers of each picture and its inverse: bits and their inverses, and steps half a period apart."""
    number = {name: place for place, name in enumerate(names)}
    found = [(place, number[name + INVERSE]) for name, place in number.items() if name + INVERSE in number]
    steps: dict[str, int] = {}
    for name in names:
        if fringe := re.fullmatch(r"(.*fringe .* step )(\d+)", name):
            steps[fringe[1]] = max(steps.get(fringe[1], 0), int(fringe[2]) + 1)
    for start, count in steps.items():
        half = count // 2
        found += [(number[f"{start}{n}"], number[f"{start}{n + half}"]) for n in range(half if count % 2 == 0 else 0)]
    return found


def _drift(place: IntArray, gain: FloatArray, taken: IntArray) -> FloatArray:
    """Return the gain (n,) at positions `taken` in the order of taking, interpolated between white photographs."""
    order = np.argsort(place)
    between = scipy.interpolate.PchipInterpolator(place[order], gain[order])
    return np.asarray(between(np.clip(taken, place[order[0]], place[order[-1]])))


def _of_pair(one: FloatArray, other: FloatArray, drift: FloatArray) -> FloatArray:
    """Return the gains (2,) of a picture and its inverse from the relative light (n,) of each."""
    design, kept = np.stack([one, other], axis=1), np.ones(len(one), dtype=bool)
    prior = 1.0 / drift
    found = prior
    for _ in range(3):
        off = design @ found - 1.0
        kept = _near(off)
        sigma = max(_GREY, float(np.std(off[kept])))
        used = design[kept]
        weight = _COUNTED / (sigma**2 * max(len(used), 1))
        normal = weight * used.T @ used + np.eye(2) / _FLICKER**2
        found = np.linalg.solve(normal, weight * used.sum(axis=0) + prior / _FLICKER**2)
    return np.asarray(1.0 / np.maximum(found, 1e-3))


def _near(off: FloatArray) -> BoolArray:
    """Return the mask (n,) of residuals that are not outliers."""
    middle = np.median(off)
    scatter = max(1.4826 * float(np.median(np.abs(off - middle))), _GREY)
    return np.asarray(np.abs(off - middle) <= _OUTLIER * scatter)
