"""Identification of the part of a board that a lattice fragment shows, over all positions and rotations."""

import math

import numpy as np
from scipy.signal import correlate

from wlr_render.captures.boards.board import BoardNotFoundError
from wlr_render.numerics.arrays import BoolArray, FloatArray, IntArray

_LEAD = 3  # dots by which the best position must be better than the second best: two misread dots cannot bridge it
_CHANCE = 2e-3  # largest probability that dots of random sizes fit the board somewhere equally well
_QUARTER = np.array([[0, 1], [-1, 0]])
_MIRROR = np.array([[0, 1], [1, 0]])
_WAYS = [mirror @ np.linalg.matrix_power(_QUARTER, q) for mirror in (np.eye(2, dtype=int), _MIRROR) for q in range(4)]
_PROPER = 4  # number of orientations that are not mirror images


def identify(index: IntArray, is_large: BoolArray, board_large: BoolArray) -> IntArray:
    """Return the (column, row) on the board of each dot of a fragment, (k, 2); some may lie beyond the board.

    Args:
        index: (k, 2) lattice coordinates, the second axis clockwise of the first as in a picture.
        is_large: (k,) measured sizes, a few of them wrong.
        board_large: (rows, columns) printed sizes.

    Raises:
        BoardNotFoundError: no position fits better than chance, or two fit about equally, or only the mirror image
            fits.
    """
    disagreeing = [_disagreeing(index @ way, is_large, board_large) for way in _WAYS]
    best = min(range(len(_WAYS)), key=lambda way: disagreeing[way].min())
    first, second = np.partition(np.concatenate([each.ravel() for each in disagreeing]), 1)[:2]
    count = len(index)
    places = len(_WAYS) * board_large.size
    if places * _share_as_good(int(first), count) > _CHANCE:
        raise BoardNotFoundError(_too_few(count, int(first), places))
    if second - first < _LEAD:
        raise BoardNotFoundError(
            f"{count} dots in one piece were seen, and they fit the board in more than one place; "
            f"more of them are needed, {count + 10} in one piece or more."
        )
    if best >= _PROPER:
        raise BoardNotFoundError("the picture is mirrored: only the mirror image of its dots is on the board.")
    turned = index @ _WAYS[best]
    row, column = np.unravel_index(int(disagreeing[best].argmin()), disagreeing[best].shape)
    return np.asarray(turned - turned.max(axis=0) + np.array([column, row]))


def _disagreeing(turned: IntArray, is_large: BoolArray, board_large: BoolArray) -> IntArray:
    """Return the number (row shifts, column shifts) of dots that differ from the board's, or are off the board.

    The first shift brings the dot of the highest column and row to the board's first.
    """
    low = turned.min(axis=0)
    columns, rows = turned.max(axis=0) - low + 1
    fragment = np.zeros((rows, columns))  # +1 large, -1 small, 0 no dot
    fragment[turned[:, 1] - low[1], turned[:, 0] - low[0]] = np.where(is_large, 1.0, -1.0)
    board = np.where(board_large, 1.0, -1.0)

    def over_all_places(of_board: FloatArray, of_fragment: FloatArray) -> IntArray:
        return np.asarray(np.rint(correlate(of_board, of_fragment, mode="full")), dtype=np.int64)

    # Dots on the board that agree minus dots that do not; and the number of dots on the board.
    balance = over_all_places(board, fragment)
    on_board = over_all_places(np.ones_like(board), np.abs(fragment))
    return np.asarray(len(turned) - (balance + on_board) // 2)


def _share_as_good(disagreeing: int, count: int) -> float:
    """Return the share of all size patterns of this length with as few disagreeing dots."""
    as_good = sum(math.comb(count, wrong) for wrong in range(disagreeing + 1))
    # Integers: a float overflows at a thousand dots.
    share: float = as_good / 2**count
    return share


def _too_few(count: int, disagreeing: int, places: int) -> str:
    needed = next(n for n in range(1, 10_000) if places * _share_as_good(0, n) <= _CHANCE)
    if count < needed:
        return f"only {count} dots in one piece were seen; at least {needed} are needed to tell which part it is."
    return (
        f"{count} dots in one piece were seen, but {disagreeing} of them have other sizes than the board has "
        "where they fit best; is it another board?"
    )
