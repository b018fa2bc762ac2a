"""Whether the bits of a Gray code were photographed in order: a panel seen through any optics is a smooth picture.

If a bit and its inverse were exchanged, or two bits, each pair of photographs is still as it should be, but the decoded
picture is torn. The order under which neighbouring pixels differ least in square is the true one.
"""

from collections.abc import Iterator, Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from wlr_render.captures.patterns.neighbours import neighbour_slices
from wlr_render.captures.patterns.shots import Shots
from wlr_render.errors import BadInputError

_LINES = 128  # of neighbours that are compared along each axis of the picture
_STRONG = 0.35  # of full contrast
_TORN = 0.9  # another order that leaves less of the sum of squared steps is the better one

Codes = NDArray[np.int64]


def check_bits(
    cell: NDArray[np.int32], lit: NDArray[np.bool_], strengths: Sequence[float], cells: int, shots: Shots
) -> None:
    """See that no other order of the photographs gives a clearly smoother picture.

    Args:
        cell: (h, w) as read.
        lit: (h, w) which pixels to ask.
        strengths: mean of each bit, the finest first, as a part of full contrast; a weak bit is not accused, since blur
            alone can turn the contrast of fine stripes around.
        cells: how many there are.
        shots: names the photographs; the last one taken is the finest bit's inverse.

    Raises:
        BadInputError: exchanging a bit with its inverse, or two bits, does.
    """
    pairs, count = _neighbouring_codes(cell ^ (cell >> 1), lit)
    if not count.size:
        return
    as_read = _tearing(np.arange(1 << len(strengths)), pairs, count, cells)
    others = [
        (_tearing(codes, pairs, count, cells), which)
        for codes, which in _other_orders(len(strengths))
        if min(strengths[bit] for bit in which) > _STRONG
    ]
    tearing, which = min(others, default=(np.inf, ()))
    if tearing < _TORN * as_read:
        photographs = [shots.taken - 2 * (1 + bit) for bit in which]
        exchanged = [photographs[0], photographs[0] + 1] if len(which) == 1 else photographs
        both = "" if len(which) == 1 else ", each with its inverse,"
        raise BadInputError(
            f"{shots.label(exchanged[0])} and {shots.label(exchanged[1])}{both} seem to be exchanged: the decoded "
            "picture is torn, and so it is whole."
        )


def _neighbouring_codes(gray: NDArray[np.int32], lit: NDArray[np.bool_]) -> tuple[Codes, NDArray[np.int64]]:
    """Different pairs of Gray codes of neighbours, (n, 2), and how often each was met, (n,)."""
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
    """What each Gray code as read would have been, were one bit inverted or two bits exchanged; and which."""
    codes = np.arange(1 << bits)
    for bit in range(bits):
        yield codes ^ (1 << bit), (bit,)
    for high, low in combinations(reversed(range(bits)), 2):
        differ = ((codes >> high) ^ (codes >> low)) & 1
        yield codes ^ (differ << high) ^ (differ << low), (high, low)


def _tearing(gray: Codes, pairs: Codes, count: NDArray[np.int64], cells: int) -> float:
    """Sum of the squared steps between neighbours; a cell beyond the last counts as a step over the whole panel.

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
