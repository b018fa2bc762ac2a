"""Patterns of black and white rectangles between grid lines, for chessboards and boards of markers."""

from abc import abstractmethod
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from wlr_render.captures.boards.board import Board, RealArray
from wlr_render.numerics.arrays import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class _Cells:
    """Cells between ascending lines across x (m + 1,) and y (n + 1,), metres, board frame; `white` is a mask (n, m)."""

    x: FloatArray
    y: FloatArray
    white: BoolArray


class CellBoard(Board):
    """Base class of boards that consist of black and white rectangles between grid lines."""

    @abstractmethod
    def _painted(self) -> tuple[FloatArray, BoolArray]:
        """Return rectangles to be painted on a white board one after the other.

        Returns:
            Left, top, right and bottom (k, 4) of each, metres, board frame; and a mask (k,) of the black ones.
        """

    @cached_property
    def _cells(self) -> _Cells:
        (corners, black), half = self._painted(), 0.5 * self.size_m
        x, y = (
            _lines(np.concatenate([corners[:, axis], corners[:, axis + 2], [-half[axis], half[axis]]]), half[axis])
            for axis in (0, 1)
        )
        white = np.ones((len(y) - 1, len(x) - 1), dtype=bool)
        edges = np.stack([_nearest(line, corners[:, k]) for k, line in enumerate((x, y, x, y))], axis=-1)
        for (left, top, right, bottom), dark in zip(edges, black, strict=True):
            white[top:bottom, left:right] = not dark
        return _Cells(x, y, white)

    def reflectance(self, in_board: RealArray, softness_m: RealArray | float = 0.0) -> RealArray:
        """Return the mean reflectance over a square of `softness_m`; see `Board.reflectance`."""
        cells = self._cells
        x, y = in_board[..., 0].astype(np.float64), in_board[..., 1].astype(np.float64)
        softness = np.broadcast_to(np.asarray(softness_m, dtype=np.float64), x.shape)
        # The integral from the corner is bilinear between grid lines, so that its differences give exact means, which
        # are far above rounding even for a square of a millionth of the board's width.
        side = np.maximum(softness, 1e-6 * (cells.x[-1] - cells.x[0]))
        total = np.zeros((len(cells.y), len(cells.x)))
        area = np.where(cells.white, np.diff(cells.y)[:, None] * np.diff(cells.x), 0.0)
        total[1:, 1:] = area.cumsum(axis=0).cumsum(axis=1)
        low_x, high_x, low_y, high_y = x - 0.5 * side, x + 0.5 * side, y - 0.5 * side, y + 0.5 * side
        sums = _integral(cells, total, high_x, high_y) - _integral(cells, total, low_x, high_y)
        sums -= _integral(cells, total, high_x, low_y) - _integral(cells, total, low_x, low_y)
        covered = (_clipped(high_x, cells.x) - _clipped(low_x, cells.x)) * (
            _clipped(high_y, cells.y) - _clipped(low_y, cells.y)
        )
        inside = (x >= cells.x[0]) & (x <= cells.x[-1]) & (y >= cells.y[0]) & (y <= cells.y[-1])
        with np.errstate(divide="ignore", invalid="ignore"):
            mean = np.clip(sums / covered, 0.0, 1.0)
        sharp = cells.white[_between(cells.y, y)[0], _between(cells.x, x)[0]]
        return np.where(inside, np.where(softness > 0, mean, sharp), np.nan).astype(in_board.dtype)

    def svg_shapes(self) -> list[str]:
        """Return one SVG path with all black cells."""
        cells = self._cells
        x, y = 1e3 * (cells.x - cells.x[0]), 1e3 * (cells.y - cells.y[0])
        runs = []
        for row, line in enumerate(~cells.white):
            change = np.diff(np.concatenate([[0], line.astype(np.int8), [0]]))
            for left, right in zip(np.nonzero(change == 1)[0], np.nonzero(change == -1)[0], strict=True):
                runs.append(f"M {x[left]:.4f} {y[row]:.4f} H {x[right]:.4f} V {y[row + 1]:.4f} H {x[left]:.4f} Z")
        # Antialiasing of a viewer must not leave a seam between cells that touch.
        return [f'<path shape-rendering="crispEdges" d="{" ".join(runs)}"/>']


def _integral(cells: _Cells, total: FloatArray, x: FloatArray, y: FloatArray) -> FloatArray:
    column, right = _between(cells.x, x)
    row, down = _between(cells.y, y)
    top = total[row, column] * (1 - right) + total[row, column + 1] * right
    bottom = total[row + 1, column] * (1 - right) + total[row + 1, column + 1] * right
    return np.asarray(top * (1 - down) + bottom * down)


def _lines(places: FloatArray, half: float) -> FloatArray:
    """Return the distinct positions, clipped to the board, ascending; positions within a nanometre are one line."""
    rising = np.unique(np.clip(places, -half, half))
    return np.asarray(rising[np.concatenate([[True], np.diff(rising) > 1e-9])])


def _nearest(lines: FloatArray, places: FloatArray) -> IntArray:
    return np.asarray(np.abs(lines[None, :] - places[:, None]).argmin(axis=1), dtype=np.int64)


def _between(lines: FloatArray, place: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return the line before each position and the fraction of the way to the next line; NaN means the first line."""
    place = np.where(np.isfinite(place), _clipped(place, lines), lines[0])
    before = np.clip(np.searchsorted(lines, place, side="right") - 1, 0, len(lines) - 2).astype(np.int64)
    return before, (place - lines[before]) / (lines[before + 1] - lines[before])


def _clipped(place: FloatArray, lines: FloatArray) -> FloatArray:
    return np.clip(place, lines[0], lines[-1])
