"""Binary-reflected Gray code along one axis of a panel: images, decoding and order check.

Exactly one bit changes between neighbouring cells, so that a pixel on the border of two cells decodes to one of them,
whatever the value of that bit. The finest bit changes at odd-numbered borders, a coarser bit at even-numbered ones.

If a bit is exchanged with its inverse or with another bit, each pair of photographs is still consistent, but the
decoded picture is discontinuous. The order with the smallest squared differences between neighbours is the true one.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import cv2
import numpy as np
from numpy.typing import NDArray

from wlr_render.captures.patterns.photometry import (
    INVERSE,
    Grey,
    NoiseMeter,
    PanelContrast,
    PhotographReader,
    check_range,
)
from wlr_render.captures.patterns.pixel_rejection import BORDER_WIDTH, neighbour_slices
from wlr_render.errors import BadInputError

_UNMIXED = 0.8  # least strength of a pixel in one stripe, where bit + inverse = white + black at any gamma
_AROUND, _SURROUNDINGS = 7, 31  # widths of windows, camera pixels
_ODD_SUM = 0.8  # error of bit + inverse over contrast that reveals a photograph of another bit, which has 1 in theory
_ODD_SHARE = 0.2  # least share of lit pixels with such an error
_FRINGE_SUM = 0.3  # error of bit + inverse over contrast that reveals fringes, if of both signs; a gamma gives one sign
_FRINGE_SHARE = 0.1  # least share of well-lit pixels with such an error, for each sign
_CLEAR_CONTRAST = 0.5  # least contrast relative to the usual one; darker pixels are dominated by noise
_SMOOTH_PX = 3  # width of smoothing windows

_ALONE_GAIN = 3.0  # variance ratio of 2 (bit - middle) to bit - inverse: 4 + 2 and 2 photographs' variances
_READABLE = 0.3  # least evidence of a finer bit that may replace the position from coarser ones

_LINES = 128  # lines along each axis of the picture whose neighbouring pixels are compared
_STRONG = 0.35  # strength of a reliable bit, relative to full contrast
_IMPROVED_BELOW = 0.9  # ratio of sums of squared steps below which another order is better


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
        """Number of bits; one cell takes none."""
        return (self.cells - 1).bit_length()

    def names(self) -> list[str]:
        """Return the names of the pictures: bits from coarse to fine, each followed by its inverse."""
        return [f"{self.axis} bit {bit}{inverse}" for bit in reversed(range(self.bits)) for inverse in ("", INVERSE)]

    def line(self, index: int) -> NDArray[np.uint8]:
        """Return the values (cells,), 0 or 255, of picture `index` of `names`."""
        bit, inverse = self.bits - 1 - index // 2, index % 2
        cell = np.arange(self.cells)
        return np.asarray((((cell ^ (cell >> 1)) >> bit) & 1 ^ inverse) * 255, dtype=np.uint8)


@dataclass(frozen=True, eq=False)
class GrayReading:
    """Decoded Gray code of one axis, all (h, w).

    Attributes:
        cell: int32, from 0; may lie beyond the last cell where bits were misread.
        position: float32, in cells: mean position of the pixel's light. Exact if a pixel sees at most one border, and
            on average over cells for any width up to two cells.
        cell_size: uint8, resolution of the position in cells: 1, or 2, 4, 8 where finer bits cannot be read.
        evidence: 0 to 1, strength of the weakest bit whose misreading would move the cell by more than `cell_size`;
            less where the camera does not resolve the cells.
        noise_gain: as in `AxisReading`, in cells squared.
        blur: standard deviation, in cells, of the position of a pixel's light, averaged over its surroundings.
    """

    cell: NDArray[np.int32]
    position: Grey
    cell_size: NDArray[np.uint8]
    evidence: Grey
    noise_gain: Grey
    blur: Grey


def read_gray(
    axis: GrayAxis, reader: PhotographReader, light: PanelContrast, noise: NoiseMeter, coarsest: int = 0
) -> GrayReading:
    """Decode the photographs of one axis.

    A missing photograph of a bit or of its inverse is replaced by white + black minus the other.

    Args:
        axis: the code.
        reader: reader at the first photograph of the axis.
        light: light of the set.
        noise: noise meter, which is updated.
        coarsest: number of the finest bits that may be unreadable; the position is then known to a coarser cell.

    Raises:
        BadInputError: both photographs of a bit are missing, a pair does not show one bit and its inverse, or the order
            is wrong.
    """
    shape = light.contrast.shape
    cell = np.zeros(shape, dtype=np.int32)
    evidence, even, odd = (np.ones(shape, dtype=np.float32) for _ in range(3))
    even_gain, odd_gain = (np.ones(shape, dtype=np.float32) for _ in range(2))
    best = GrayReading(cell, even, np.zeros(shape, dtype=np.uint8), np.full(shape, -1, dtype=np.float32), even, even)
    usual: list[float] = []
    unread = 0
    for bit in reversed(range(axis.bits)):
        pair = _read_pair(reader, light, noise)
        if pair is None or unread:
            unread += 1
            _check_unread(pair is None, unread + bit, coarsest, axis.bits, reader)
            continue
        signed, gain = pair
        strength = np.abs(signed)
        usual.insert(0, float(np.mean(strength[light.lit])))
        one = signed > 0
        # The previous bit can change at the even border only if this bit is 1, and the earlier candidate only if this
        # bit is 0; a change of the other would move the cell further.
        evidence = np.minimum(evidence, np.where(one, even, odd))
        even, even_gain = np.where(one, odd, even), np.where(one, odd_gain, even_gain)
        odd, odd_gain = strength, np.full(shape, gain, dtype=np.float32)
        cell = 2 * cell + (one ^ (cell & 1)).astype(np.int32)
        if bit <= coarsest:
            usable = np.minimum(evidence, _resolved(even + odd, light.lit))
            side = 1 - 2 * (cell & 1).astype(np.float32)  # the even border is the left one of an even cell
            offset = np.asarray(0.5 * side * (even - odd), dtype=np.float32)
            size = np.float32(2**bit)
            reading = GrayReading(
                cell,
                (cell + np.float32(0.5) + offset) * size,
                np.full(shape, 2**bit, dtype=np.uint8),
                usable,
                # The offset is half the difference of two strengths, each with noise of a difference and the contrast.
                (0.25 * (even_gain + odd_gain) + offset**2) * size**2,
                np.clip(2 - _mean_around(even + odd, light.lit, _SURROUNDINGS), 0, 2) / np.float32(BORDER_WIDTH) * size,
            )
            best = _better(reading, best)
    if not unread:
        _check_photograph_order(cell, light.lit, usual, axis.cells, reader)
    if not axis.bits:
        ones = np.ones(shape, dtype=np.float32)
        return GrayReading(cell, 0.5 * ones, np.ones(shape, dtype=np.uint8), ones, 0.5 * ones, 0 * ones)
    return replace(best, cell=cell)


def _read_pair(reader: PhotographReader, light: PanelContrast, noise: NoiseMeter) -> tuple[Grey, float] | None:
    """Return bit - inverse over contrast (h, w), and the variance ratio of its numerator to a difference's.

    The result is None if both photographs are missing.
    """
    positive = _take_checked(reader, light)
    inverse = _take_checked(reader, light)
    if positive is not None and inverse is not None:
        steady = positive + inverse - 2 * light.middle
        _check_pair(steady, light, reader)
        signed = (positive - inverse) * light.per_contrast
        noise.add(steady, light.lit & (np.abs(signed) > _UNMIXED))
        return signed, 1.0
    if positive is not None:
        return 2 * (positive - light.middle) * light.per_contrast, _ALONE_GAIN
    return None if inverse is None else (2 * (light.middle - inverse) * light.per_contrast, _ALONE_GAIN)


def _take_checked(reader: PhotographReader, light: PanelContrast) -> Grey | None:
    image = reader.take()
    if image is not None:
        check_range(image, light, reader)
    return image


def _check_unread(missing: bool, levels: int, coarsest: int, bits: int, reader: PhotographReader) -> None:
    """Refuse missing bits, unless only the finest are missing."""
    first, second = reader.label(reader.taken - 2), reader.label(reader.taken - 1)
    if not missing:
        raise BadInputError(f"A bit coarser than {first} is missing together with its inverse; take it again.")
    if levels > coarsest or levels >= bits:
        raise BadInputError(f"{first} and {second} are missing; one of the two is needed to read the bit.")


def _better(reading: GrayReading, best: GrayReading) -> GrayReading:
    """Use the finer reading where it is reliable, or at least better than the coarser one."""
    finer = (reading.evidence >= _READABLE) | (reading.evidence > best.evidence)
    if finer.all():
        return reading
    return GrayReading(**{name: np.where(finer, value, getattr(best, name)) for name, value in vars(reading).items()})


def _resolved(borders: Grey, lit: NDArray[np.bool_]) -> Grey:
    """Return the resolution of single cells (h, w), 0 to 1, from the summed strengths of both borders of a cell.

    For a pixel w cells wide, the sum is never below 2 / w, except at every other border where blur removes the finest
    bit. The result is 1 for up to two cells, and 0 for four or more.
    """
    return np.asarray(np.clip(2 * _mean_around(borders, lit, _AROUND) - 1, 0, 1), dtype=np.float32)


def _mean_around(value: Grey, lit: NDArray[np.bool_], width: int) -> Grey:
    """Return the mean (h, w) over the lit pixels of a window."""
    total = cv2.boxFilter(value * lit, -1, (width, width), normalize=False)
    number = cv2.boxFilter(lit.astype(np.float32), -1, (width, width), normalize=False)
    return np.asarray(total / np.maximum(number, 1), dtype=np.float32)


def _check_pair(steady: Grey, light: PanelContrast, reader: PhotographReader) -> None:
    """Refuse a bit and its inverse that do not add up to white + black."""
    off = np.abs(steady) > _ODD_SUM * light.contrast
    share = float(np.mean(off[light.lit]))
    if share > _ODD_SHARE:
        raise BadInputError(
            f"{reader.label(reader.taken - 2)} and {reader.label(reader.taken - 1)} do not add up to white + black in "
            f"{share:.0%} of the lit pixels: one of them is missing, out of order or of another exposure, or the "
            "photographs show another code."
        )
    well_lit = light.lit & (light.contrast > _CLEAR_CONTRAST * light.usual_contrast)
    smooth = cv2.blur(steady, (_SMOOTH_PX, _SMOOTH_PX)) * light.per_contrast
    both_ways = [float(np.mean((sign * smooth > _FRINGE_SUM)[well_lit])) for sign in (1, -1)]
    if min(both_ways) > _FRINGE_SHARE:
        raise BadInputError(
            f"{reader.label(reader.taken - 2)} and {reader.label(reader.taken - 1)} are not a bit and its inverse: "
            f"their sum is above white + black in {both_ways[0]:.0%} of the lit pixels and below it in "
            f"{both_ways[1]:.0%}, as with fringes; choose the code that was shown as pattern."
        )


Codes = NDArray[np.int64]


def _check_photograph_order(
    cell: NDArray[np.int32], lit: NDArray[np.bool_], strengths: Sequence[float], cells: int, reader: PhotographReader
) -> None:
    """Refuse photographs that decode to a clearly smoother picture in another order.

    Args:
        cell: (h, w) cells as read.
        lit: (h, w) mask of the pixels to test.
        strengths: mean strength of each bit, the finest first, relative to full contrast; a weak bit is not reported,
            since blur alone can reverse the contrast of fine stripes.
        cells: number of cells.
        reader: reader that names the photographs; the last one is the finest bit's inverse.

    Raises:
        BadInputError: exchanging a bit with its inverse, or two bits, gives a smoother picture.
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
    """Return the distinct pairs (n, 2) of Gray codes of neighbouring pixels, and their counts (n,)."""
    pairs = []
    for (dx, dy), length in (((1, 0), gray.shape[0]), ((0, 1), gray.shape[1])):
        every = max(1, length // _LINES)
        some = (slice(None, None, every), slice(None)) if dx else (slice(None), slice(None, None, every))
        here, there = neighbour_slices(dx, dy)
        both = lit[some][here] & lit[some][there]
        pairs.append(np.stack([gray[some][here][both], gray[some][there][both]], axis=-1).astype(np.int64))
    joined = np.concatenate(pairs)
    packed, count = np.unique((joined[:, 0] << 32) | joined[:, 1], return_counts=True)
    return np.stack([packed >> 32, packed & 0xFFFFFFFF], axis=-1), count


def _other_orders(bits: int) -> Iterator[tuple[Codes, tuple[int, ...]]]:
    """Yield all Gray codes with one bit inverted or two bits exchanged, and the numbers of these bits."""
    codes = np.arange(1 << bits)
    for bit in range(bits):
        yield codes ^ (1 << bit), (bit,)
    for high, low in combinations(reversed(range(bits)), 2):
        differ = ((codes >> high) ^ (codes >> low)) & 1
        yield codes ^ (differ << high) ^ (differ << low), (high, low)


def _roughness(gray: Codes, pairs: Codes, count: NDArray[np.int64], cells: int) -> float:
    """Return the sum of squared steps between neighbours; a cell off the panel counts as a step of the panel's size.

    Args:
        gray: (2**bits,) true Gray code of each code that was read.
        pairs: (n, 2) Gray codes as read.
        count: (n,) number of occurrences.
        cells: number of cells.
    """
    cell = gray.copy()
    shift = 1
    while shift < cell.size:
        cell ^= cell >> shift
        shift *= 2
    sides = cell[pairs]
    steps = (sides[:, 0] - sides[:, 1]) ** 2
    return float(np.sum(count * np.where(np.any(sides >= cells, axis=-1), cells**2, steps)))
