"""Patterns of black and white rectangles between grid lines, for chessboards and boards of markers."""

from abc import abstractmethod
from dataclasses import dataclass

import numpy as np

from wlr_render.captures.boards.board import Board, RealArray
from wlr_render.numerics.arrays import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class CellPattern:
    """Cells between lines across x and y.

    Attributes:
        x: (m + 1,) lines, metres, board frame, ascending; the first and last are the board's edges.
        y: (n + 1,) lines across y, likewise.
        white: (n, m) mask of white cells.
    """

    x: FloatArray
    y: FloatArray
    white: BoolArray

    @classmethod
    def of_black(cls, size_m: FloatArray, corners: FloatArray, black: BoolArray) -> "CellPattern":
        """Return the pattern of rectangles painted one after the other on a white board.

        Args:
            size_m: (2,) size of the board.
            corners: (k, 4) left, top, right and bottom of each, metres, board frame.
            black: (k,) black or white.
        """
        half = 0.5 * size_m
        x, y = (
            _lines(np.concatenate([corners[:, axis], corners[:, axis + 2], [-half[axis], half[axis]]]), half[axis])
            for axis in (0, 1)
        )
        white = np.ones((len(y) - 1, len(x) - 1), dtype=bool)
        edges = np.stack([_nearest(line, corners[:, k]) for k, line in enumerate((x, y, x, y))], axis=-1)
        for (left, top, right, bottom), dark in zip(edges, black, strict=True):
            white[top:bottom, left:right] = not dark
        return cls(x, y, white)

    def reflectance(self, in_board: RealArray, softness_m: RealArray | float) -> RealArray:
        """Return the mean reflectance over a square of `softness_m` at positions (..., 2); NaN beyond the edge."""
        x, y = in_board[..., 0].astype(np.float64), in_board[..., 1].astype(np.float64)
        softness = np.broadcast_to(np.asarray(softness_m, dtype=np.float64), x.shape)
        # The integral from the corner is bilinear between the lines, so that its differences are exact means; over a
        # millionth of the board's width they are still far above rounding.
        side = np.maximum(softness, 1e-6 * (self.x[-1] - self.x[0]))
        total = np.zeros((len(self.y), len(self.x)))
        area = np.where(self.white, np.diff(self.y)[:, None] * np.diff(self.x), 0.0)
        total[1:, 1:] = area.cumsum(axis=0).cumsum(axis=1)
        low_x, high_x, low_y, high_y = x - 0.5 * side, x + 0.5 * side, y - 0.5 * side, y + 0.5 * side
        sums = self._integral(total, high_x, high_y) - self._integral(total, low_x, high_y)
        sums -= self._integral(total, high_x, low_y) - self._integral(total, low_x, low_y)
        covered = (_clipped(high_x, self.x) - _clipped(low_x, self.x)) * (
            _clipped(high_y, self.y) - _clipped(low_y, self.y)
        )
        inside = (x >= self.x[0]) & (x <= self.x[-1]) & (y >= self.y[0]) & (y <= self.y[-1])
        with np.errstate(divide="ignore", invalid="ignore"):
            mean = np.clip(sums / covered, 0.0, 1.0)
        sharp = self.white[_between(self.y, y)[0], _between(self.x, x)[0]]
        return np.where(inside, np.where(softness > 0, mean, sharp), np.nan).astype(in_board.dtype)

    def svg_shapes(self) -> list[str]:
        """Return one SVG path of all black cells, millimetres from the top left corner."""
        x, y = 1e3 * (self.x - self.x[0]), 1e3 * (self.y - self.y[0])
        runs = []
        for row, line in enumerate(~self.white):
            change = np.diff(np.concatenate([[0], line.astype(np.int8), [0]]))
            for left, right in zip(np.nonzero(change == 1)[0], np.nonzero(change == -1)[0], strict=True):
                runs.append(f"M {x[left]:.4f} {y[row]:.4f} H {x[right]:.4f} V {y[row + 1]:.4f} H {x[left]:.4f} Z")
        # Cells that touch must not show a seam where a viewer smooths their edges.
        return [f'<path shape-rendering="crispEdges" d="{" ".join(runs)}"/>']

    def _integral(self, total: FloatArray, x: FloatArray, y: FloatArray) -> FloatArray:
        column, right = _between(self.x, x)
        row, down = _between(self.y, y)
        top = total[row, column] * (1 - right) + total[row, column + 1] * right
        bottom = total[row + 1, column] * (1 - right) + total[row + 1, column + 1] * right
        return np.asarray(top * (1 - down) + bottom * down)


class CellBoard(Board):
    """Base of boards that consist of cells."""

    @property
    @abstractmethod
    def _pattern(self) -> CellPattern: ...

    def reflectance(self, in_board: RealArray, softness_m: RealArray | float = 0.0) -> RealArray:
        """Return the reflectance; see `Board.reflectance`."""
        return self._pattern.reflectance(in_board, softness_m)

    def svg_shapes(self) -> list[str]:
        """Return one path of all black cells."""
        return self._pattern.svg_shapes()


def _lines(places: FloatArray, half: float) -> FloatArray:
    """Return the distinct positions within the board, ascending; positions within a nanometre are one line."""
    rising = np.unique(np.clip(places, -half, half))
    return np.asarray(rising[np.concatenate([[True], np.diff(rising) > 1e-9])])


def _nearest(lines: FloatArray, places: FloatArray) -> IntArray:
    return np.asarray(np.abs(lines[None, :] - places[:, None]).argmin(axis=1), dtype=np.int64)


def _between(lines: FloatArray, place: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return the line before each position, and the fraction of the way to the next; NaN counts as the first line."""
    place = np.where(np.isfinite(place), _clipped(place, lines), lines[0])
    before = np.clip(np.searchsorted(lines, place, side="right") - 1, 0, len(lines) - 2).astype(np.int64)
    return before, (place - lines[before]) / (lines[before + 1] - lines[before])


def _clipped(place: FloatArray, lines: FloatArray) -> FloatArray:
    return np.clip(place, lines[0], lines[-1])
