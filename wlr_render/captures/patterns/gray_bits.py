"""Binary-reflected Gray code over the cells of one axis of a panel: its lines, and how photographs of them are read.

Between neighbouring cells exactly one bit changes, so that a pixel that sees the border of two cells reads one of the
two whatever that bit says. At odd-numbered borders it is the finest bit that changes, at even-numbered ones a coarser.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from wlr_render.captures.patterns.gray_order import check_bits
from wlr_render.captures.patterns.photometry import Light, NoiseMeter, check_range
from wlr_render.captures.patterns.shots import Grey, Shots
from wlr_render.errors import BadInputError

_UNMIXED = 0.8  # a stripe that fills the pixel this much adds up with its inverse to white + black at any gamma
_AROUND = 7  # camera pixels
_ODD_SUM = 0.8  # of the contrast: positive + inverse is off by one contrast where one of the two is another bit's
_ODD_SHARE = 0.2  # of the lit pixels


@dataclass(frozen=True)
class GrayAxis:
    """The code of one axis.

    Attributes:
        axis: "u" or "v".
        cells: how many cells are told apart.
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
    """What the photographs of one axis say, all (h, w).

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


def read_gray(axis: GrayAxis, shots: Shots, light: Light, noise: NoiseMeter) -> GrayReading:
    """Take the photographs of one axis.

    Raises:
        BadInputError: a photograph is missing, those of a bit and its inverse are not of one bit, or out of order.
    """
    per_contrast = light.per_contrast
    cell = np.zeros(light.contrast.shape, dtype=np.int32)
    evidence, even, odd = (np.ones(light.contrast.shape, dtype=np.float32) for _ in range(3))
    usual: list[float] = []
    for _ in range(axis.bits):
        positive = shots.take()
        check_range(positive, light, shots)
        inverse = shots.take()
        check_range(inverse, light, shots)
        steady = positive + inverse - 2 * light.middle
        _check_pair(steady, light, shots)
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
    check_bits(cell, light.lit, usual, axis.cells, shots)
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


def _check_pair(steady: Grey, light: Light, shots: Shots) -> None:
    """A bit and its inverse add up to white + black, whichever of the two a pixel sees."""
    off = np.abs(steady) > _ODD_SUM * light.contrast
    share = float(np.mean(off[light.lit]))
    if share > _ODD_SHARE:
        raise BadInputError(
            f"{shots.label(shots.taken - 2)} and {shots.label(shots.taken - 1)} do not add up to white + black in "
            f"{share:.0%} of the lit pixels: one of them is missing, out of order or of another exposure."
        )
