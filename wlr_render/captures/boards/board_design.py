"""Design of dot boards: a choice of large dots for which every 5 x 5 window has a unique position and rotation."""

import hashlib

import numpy as np
from numpy.typing import NDArray

from wlr_render.captures.boards.dot_board import DotBoard
from wlr_render.errors import BadInputError
from wlr_render.numerics.arrays import BoolArray

WINDOW = 5
"""Any window of this many dots square differs from every other, turned or mirrored, in at least `DISTANCE` sizes."""
DISTANCE = 3

_LARGE, _SMALL, _MARGIN = 0.6, 0.38, 1.0  # usual sizes in pitches: areas 2.5 to 1, and a clear gap between large dots
_MOST_STEPS = 10_000  # most steps of the search beyond one per dot, before it gives up
_IntArray = NDArray[np.int64]
_NOTHING: _IntArray = np.zeros(0, dtype=np.int64)


def design_board(
    columns: int,
    rows: int,
    pitch_m: float,
    seed: int = 1,
) -> DotBoard:
    """Design a board with unique 5 x 5 windows (see `WINDOW`); the same arguments give the same board everywhere.

    Args:
        columns, rows: number of dots along x and y.
        pitch_m: distance of neighbouring dots.
        seed: seed of the design.

    Raises:
        BadInputError: the board is too small or too large for `WINDOW`.
    """
    if min(columns, rows) < WINDOW:
        raise BadInputError(f"A board of {columns} x {rows} dots is too small; take at least {WINDOW} x {WINDOW}.")
    large = _choose_sizes(columns, rows, seed)
    return DotBoard(pitch_m, _LARGE * pitch_m, _SMALL * pitch_m, _MARGIN * pitch_m, large)


def check_sizes(pitch_m: float, large_m: float, small_m: float, margin_m: float) -> None:
    """Refuse a board on which large and small dots could not be distinguished.

    Raises:
        BadInputError: the message has the sizes in millimetres and the remedy.
    """
    if not 0 < small_m < large_m:
        raise BadInputError(
            f"large_mm and small_mm are {_mm(large_m, small_m)}: the large dot must be larger, and both above zero."
        )
    if large_m > 0.85 * pitch_m:
        raise BadInputError(
            f"Large dots of {_mm(large_m)} nearly touch at a pitch of {_mm(pitch_m)}; take at most 0.85 of the pitch."
        )
    if large_m < 1.25 * small_m:
        raise BadInputError(f"Dots of {_mm(large_m, small_m)} are too similar; take diameters 1.25 to 1 or more.")
    if margin_m < 0.75 * large_m:
        raise BadInputError(
            f"A margin of {_mm(margin_m)} leaves no white around dots of {_mm(large_m)}; "
            "take at least three quarters of the large diameter."
        )


def _mm(*lengths_m: float) -> str:
    return " and ".join(f"{1e3 * length:g} mm" for length in lengths_m)


def _choose_sizes(columns: int, rows: int, seed: int) -> BoolArray:
    """Choose the size of each dot, row by row, and backtrack where both sizes would repeat a window.

    Raises:
        BadInputError: the board is too large for unique windows.
    """
    large = _random_bits(columns * rows, seed).reshape(rows, columns)
    taken = _TakenWindows()
    flipped = np.zeros(columns * rows, dtype=bool)
    dot, steps = 0, 0
    while dot < large.size:
        steps += 1
        if dot < 0 or steps > large.size + _MOST_STEPS:
            raise BadInputError(
                f"A board of {columns} x {rows} dots is too large for windows of {WINDOW} x {WINDOW} that differ in "
                f"{DISTANCE} sizes; use fewer dots, or several boards."
            )
        if taken.take(dot, _window_ending_at(large, dot)):
            dot += 1
            continue
        while dot >= 0 and flipped[dot]:
            flipped[dot] = False
            dot -= 1
            taken.release(dot)
        if dot >= 0:
            flipped[dot] = True
            large.flat[dot] ^= True
    return large


def _window_ending_at(large: BoolArray, dot: int) -> BoolArray:
    """Return the window with `dot` as its last dot, counted row by row; empty if the dot completes no window."""
    row, column = divmod(dot, large.shape[1])
    if min(row, column) < WINDOW - 1:
        return large[:0, :0]
    return large[row - WINDOW + 1 : row + 1, column - WINDOW + 1 : column + 1]


def _random_bits(number: int, seed: int) -> BoolArray:
    """Return pseudo-random bits (number,) that do not depend on a library's version."""
    stream = hashlib.shake_256(f"two-size dot board {seed}".encode()).digest(number // 8 + 1)
    return np.unpackbits(np.frombuffer(stream, np.uint8))[:number].astype(bool)


class _TakenWindows:
    """Windows on the board so far, as integer codes in all 8 orientations, plus all codes at Hamming distance 1.

    Two windows differ in `DISTANCE` = 3 sizes or more exactly if no code is within one dot of both, so that the codes
    of different windows never overlap and can be released again.
    """

    def __init__(self) -> None:
        self._taken = np.zeros(1 << WINDOW**2, dtype=bool)
        self._near: dict[int, _IntArray] = {}
        self._within_one = np.concatenate([[0], 1 << np.arange(WINDOW**2)])
        square = np.arange(WINDOW**2).reshape(WINDOW, WINDOW)
        self._positions = np.array([np.rot90(each, q).ravel() for each in (square, square.T) for q in range(4)])

    def take(self, name: int, window: BoolArray) -> bool:
        """Take a window if it differs enough from all others and from itself turned; return whether it was taken.

        An empty window is always taken.
        """
        if not window.size:
            return True
        numbers = window.ravel()[self._positions] @ (1 << np.arange(WINDOW**2))
        near = (numbers[:, None] ^ self._within_one).ravel()
        if self._taken[near].any() or len(np.unique(near)) < len(near):
            return False
        self._taken[near] = True
        self._near[name] = near
        return True

    def release(self, name: int) -> None:
        """Release a window."""
        self._taken[self._near.pop(name, _NOTHING)] = False
