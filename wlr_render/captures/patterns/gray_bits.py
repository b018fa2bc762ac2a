"""Binary-reflected Gray code along one axis of a panel: its images, their decoding, order check and bit contrast.

Between neighbouring cells exactly one bit changes, so that a pixel that sees the border of two cells reads one of the
two whatever that bit says. At odd-numbered borders it is the finest bit that changes, at even-numbered ones a coarser.

If a bit was exchanged with its inverse, or with another bit, each pair of photographs is still consistent, but the
decoded picture is discontinuous. The order with the smallest squared differences between neighbours is the true one.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import cv2
import numpy as np
from numpy.typing import NDArray

from wlr_render.captures.decoded import DEFAULT_OPTIONS, DecodeOptions
from wlr_render.captures.patterns.pattern import Pattern
from wlr_render.captures.patterns.photometry import (
    Grey,
    NoiseMeter,
    PanelLight,
    PhotographReader,
    check_range,
    read_light,
)
from wlr_render.captures.patterns.pixel_rejection import neighbour_slices
from wlr_render.captures.photographs import Photograph
from wlr_render.errors import BadInputError

_UNMIXED = 0.8  # a stripe that fills the pixel this much adds up with its inverse to white + black at any gamma
_AROUND = 7  # camera pixels
_ODD_SUM = 0.8  # of the contrast: positive + inverse is off by one contrast where one of the two is another bit's
_ODD_SHARE = 0.2  # of the lit pixels

_LINES = 128  # of neighbours that are compared along each axis of the picture
_STRONG = 0.35  # of full contrast
_IMPROVED_BELOW = 0.9  # another order that leaves less of the sum of squared steps is the better one
WEAK = 0.5
"""A bit is weak if its median strength is below this part of full contrast."""
_WELL_LIT = 0.25  # of the contrast that the brightest twentieth of the lit pixels exceeds
_INVERSE = " inverse"


@dataclass(frozen=True)
class GrayAxis:
    """The code of one axis.

    Attributes:
        axis: "u" or "v".
        cells: number of cells.
    """

    axis: str
    cells: int

    @property
    def bits(self) -> int:
        """How many bits it takes; one cell takes none."""
        return (self.cells - 1).bit_length()

    def names(self) -> list[str]:
        """Names of its pictures: bits from coarse to fine, each followed by its inverse."""
        return [f"{self.axis} bit {bit}{inverse}" for bit in reversed(range(self.bits)) for inverse in ("", " inverse")]

    def line(self, index: int) -> NDArray[np.uint8]:
        """(cells,) 0 or 255: what picture `index` of `names` shows in each cell."""
        bit, inverse = self.bits - 1 - index // 2, index % 2
        cell = np.arange(self.cells)
        return np.asarray((((cell ^ (cell >> 1)) >> bit) & 1 ^ inverse) * 255, dtype=np.uint8)


@dataclass(frozen=True, eq=False)
class GrayReading:
    """Decoded Gray code of one axis, all (h, w).

    Attributes:
        cell: int32, from 0; may lie beyond the last cell where bits were misread.
        evidence: 0 to 1, the weakest of the bits whose misreading would move the cell by more than one, or less where
            the camera does not resolve the cells.
        even_border, odd_border: 0 to 1 but for noise, strength of the bit that changes at the cell's even-numbered and
            at its odd-numbered border: how far the pixel stays clear of that border.
    """

    cell: NDArray[np.int32]
    evidence: Grey
    even_border: Grey
    odd_border: Grey

    @property
    def offset(self) -> Grey:
        """(h, w) -0.5 to 0.5 but for noise: where in its cell the mean of what the pixel sees lies, in cells.

        Exact where a pixel sees one border at most, and in the mean over cells for any width up to two cells.
        """
        side = 1 - 2 * (self.cell & 1).astype(np.float32)  # the even border is the left one of an even cell
        return np.asarray(0.5 * side * (self.even_border - self.odd_border), dtype=np.float32)


def read_gray(axis: GrayAxis, reader: PhotographReader, light: PanelLight, noise: NoiseMeter) -> GrayReading:
    """Decode the photographs of one axis.

    Raises:
        BadInputError: a photograph is missing, those of a bit and its inverse are not of one bit, or out of order.
    """
    per_contrast = light.per_contrast
    cell = np.zeros(light.contrast.shape, dtype=np.int32)
    evidence, even, odd = (np.ones(light.contrast.shape, dtype=np.float32) for _ in range(3))
    usual: list[float] = []
    for _ in range(axis.bits):
        positive = reader.take()
        check_range(positive, light, reader)
        inverse = reader.take()
        check_range(inverse, light, reader)
        steady = positive + inverse - 2 * light.middle
        _check_pair(steady, light, reader)
        signed = (positive - inverse) * per_contrast
        strength = np.abs(signed)
        usual.insert(0, float(np.mean(strength[light.lit])))
        noise.add(steady, light.lit & (strength > _UNMIXED))
        one = signed > 0
        # The bit before this one can still be the one that changes at the even border only if this bit is 1, and the
        # one that could so far only if this bit is 0; the other of the two would move the cell further.
        evidence = np.minimum(evidence, np.where(one, even, odd))
        even = np.where(one, odd, even)
        odd = strength
        cell = 2 * cell + (one ^ (cell & 1)).astype(np.int32)
    check_photograph_order(cell, light.lit, usual, axis.cells, reader)
    return GrayReading(cell, np.minimum(evidence, _resolved(even + odd, light.lit)), even, odd)


def _resolved(borders: Grey, lit: NDArray[np.bool_]) -> Grey:
    """(h, w) 0 to 1: whether single cells are resolved, from the sum of the strengths of both borders of a cell.

    A pixel w cells wide never lies so close to both borders that the sum falls below 2 / w; where blur takes the finest
    bit, it does at every other border. 1 up to two cells, 0 from four on.
    """
    window = (_AROUND, _AROUND)
    total = cv2.boxFilter(borders * lit, -1, window, normalize=False)
    number = cv2.boxFilter(lit.astype(np.float32), -1, window, normalize=False)
    return np.asarray(np.clip(2 * total / np.maximum(number, 1) - 1, 0, 1), dtype=np.float32)


def _check_pair(steady: Grey, light: PanelLight, reader: PhotographReader) -> None:
    """A bit and its inverse add up to white + black, whichever of the two a pixel sees."""
    off = np.abs(steady) > _ODD_SUM * light.contrast
    share = float(np.mean(off[light.lit]))
    if share > _ODD_SHARE:
        raise BadInputError(
            f"{reader.label(reader.taken - 2)} and {reader.label(reader.taken - 1)} do not add up to white + black in "
            f"{share:.0%} of the lit pixels: one of them is missing, out of order or of another exposure."
        )


Codes = NDArray[np.int64]


def check_photograph_order(
    cell: NDArray[np.int32], lit: NDArray[np.bool_], strengths: Sequence[float], cells: int, reader: PhotographReader
) -> None:
    """Refuse photographs that decode to a clearly smoother picture in another order.

    Args:
        cell: (h, w) as read.
        lit: (h, w) which pixels to test.
        strengths: mean of each bit, the finest first, as a part of full contrast; a weak bit is not accused, since blur
            alone can turn the contrast of fine stripes around.
        cells: how many there are.
        reader: names the photographs; the last one taken is the finest bit's inverse.

    Raises:
        BadInputError: exchanging a bit with its inverse, or two bits, does.
    """
    pairs, count = _neighbouring_codes(cell ^ (cell >> 1), lit)
    if not count.size:
        return
    as_read = _roughness(np.arange(1 << len(strengths)), pairs, count, cells)
    others = [
        (_roughness(codes, pairs, count, cells), which)
        for codes, which in _other_orders(len(strengths))
        if min(strengths[bit] for bit in which) > _STRONG
    ]
    roughness, which = min(others, default=(np.inf, ()))
    if roughness < _IMPROVED_BELOW * as_read:
        photographs = [reader.taken - 2 * (1 + bit) for bit in which]
        exchanged = [photographs[0], photographs[0] + 1] if len(which) == 1 else photographs
        both = "" if len(which) == 1 else ", each with its inverse,"
        raise BadInputError(
            f"Decoding fails in the order given but succeeds with {reader.label(exchanged[0])} and "
            f"{reader.label(exchanged[1])}{both} exchanged."
        )


def _neighbouring_codes(gray: NDArray[np.int32], lit: NDArray[np.bool_]) -> tuple[Codes, NDArray[np.int64]]:
    """Distinct pairs of Gray codes of neighbours, (n, 2), and their counts, (n,)."""
    found = []
    for (dx, dy), length in (((1, 0), gray.shape[0]), ((0, 1), gray.shape[1])):
        every = max(1, length // _LINES)
        some = (slice(None, None, every), slice(None)) if dx else (slice(None), slice(None, None, every))
        here, there = neighbour_slices(dx, dy)
        both = lit[some][here] & lit[some][there]
        found.append(np.stack([gray[some][here][both], gray[some][there][both]], axis=-1).astype(np.int64))
    joined = np.concatenate(found)
    packed, count = np.unique((joined[:, 0] << 32) | joined[:, 1], return_counts=True)
    return np.stack([packed >> 32, packed & 0xFFFFFFFF], axis=-1), count


def _other_orders(bits: int) -> Iterator[tuple[Codes, tuple[int, ...]]]:
    """Gray codes with one bit inverted or two bits exchanged, and the bits."""
    codes = np.arange(1 << bits)
    for bit in range(bits):
        yield codes ^ (1 << bit), (bit,)
    for high, low in combinations(reversed(range(bits)), 2):
        differ = ((codes >> high) ^ (codes >> low)) & 1
        yield codes ^ (differ << high) ^ (differ << low), (high, low)


def _roughness(gray: Codes, pairs: Codes, count: NDArray[np.int64], cells: int) -> float:
    """Sum of squared steps between neighbours; a cell beyond the last counts as a step over the whole panel.

    Args:
        gray: (2**bits,) true Gray code of each that was read.
        pairs: (n, 2) Gray codes as read.
        count: (n,) how often.
        cells: how many there are.
    """
    cell = gray.copy()
    shift = 1
    while shift < cell.size:
        cell ^= cell >> shift
        shift *= 2
    sides = cell[pairs]
    steps = (sides[:, 0] - sides[:, 1]) ** 2
    return float(np.sum(count * np.where(np.any(sides >= cells, axis=-1), cells**2, steps)))


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
    photographs: Iterable[Photograph], pattern: Pattern, options: DecodeOptions = DEFAULT_OPTIONS
) -> tuple[BitStrength, ...]:
    """Measure the contrast of each bit that is followed by its inverse; photographs as `pattern.decode` takes them.

    Raises:
        BadInputError: photographs are missing or left over, of different sizes, or under- or over-exposed.
    """
    names = pattern.names()
    reader = PhotographReader(photographs, names)
    light = read_light(reader, options)
    well_lit = light.lit & (light.contrast >= _WELL_LIT * np.percentile(light.contrast[light.lit], 95))
    full = light.contrast[well_lit]
    strengths = []
    earlier = light.middle
    for number, name in enumerate(names[2:], start=2):
        image = reader.take()
        if name == names[number - 1] + _INVERSE:
            strength = np.abs(image - earlier)[well_lit] / full
            strengths.append(_judged(names[number - 1], strength, options.min_confidence))
        earlier = image
    reader.finish()
    return tuple(strengths)


def _judged(name: str, strength: Grey, min_confidence: float) -> BitStrength:
    first, fifth, median = (float(value) for value in np.percentile(strength, (1, 5, 50)))
    return BitStrength(name, median, fifth, first, float(np.mean(strength < min_confidence)))
