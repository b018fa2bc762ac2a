"""ChArUco boards: a chessboard with a marker in each white square, so that any part of it is identified."""

from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from wlr_render.captures.boards.board import (
    USUAL_TOLERANCES,
    BoardNotFoundError,
    BoardObservation,
    BoardTolerances,
    grid_indices,
    grid_points,
)
from wlr_render.captures.boards.cell_pattern import CellBoard, CellPattern
from wlr_render.captures.boards.corner_observation import observe_corners
from wlr_render.captures.boards.markers import dictionary_of, marker_cells
from wlr_render.captures.photographs import Photograph, as_bytes
from wlr_render.geometry.lens_camera import OPENCV_PIXEL_SHIFT
from wlr_render.numerics.arrays import FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class CharucoBoard(CellBoard):
    """A ChArUco board; its features are the inner corners of the chessboard.

    Attributes:
        square_columns, square_rows: numbers of squares.
        square_m: side of a square.
        marker_m: side of a marker.
        dictionary: OpenCV's name of the markers, e.g. "DICT_5X5_1000".
        legacy: the pattern of OpenCV before 4.6 (and of many printed boards), in which boards of an even number of
            rows begin with a white square.
        margin_m: white around the squares.
        tolerances: how far the print may differ.
    """

    square_columns: int
    square_rows: int
    square_m: float
    marker_m: float
    dictionary: str
    legacy: bool = False
    margin_m: float = 0.0
    tolerances: BoardTolerances = USUAL_TOLERANCES

    @property
    def size_m(self) -> FloatArray:
        """(2,) width and height with the margin."""
        return np.array([self.square_columns, self.square_rows]) * self.square_m + 2 * self.margin_m

    @property
    def title(self) -> str:
        """Kind, numbers and sizes in words."""
        return (
            f"ChArUco board {self.square_columns} x {self.square_rows} squares of {1e3 * self.square_m:g} mm, markers "
            f"{self.dictionary} {1e3 * self.marker_m:g} mm{', legacy pattern' if self.legacy else ''}"
        )

    @property
    def finest_m(self) -> float:
        """Side of a marker's bit."""
        return self.marker_m / (dictionary_of(self.dictionary).markerSize + 2)

    def indices(self) -> IntArray:
        """(column, row) of all inner corners, row by row."""
        return grid_indices(self.square_columns - 1, self.square_rows - 1)

    def point_of(self, index: NDArray[np.integer]) -> FloatArray:
        """Corners (..., 3), board frame, by (column, row), (..., 2)."""
        return grid_points(index, self.square_columns - 1, self.square_rows - 1, self.square_m)

    @property
    def _opencv(self) -> cv2.aruco.CharucoBoard:
        made = cv2.aruco.CharucoBoard(
            (self.square_columns, self.square_rows), self.square_m, self.marker_m, dictionary_of(self.dictionary)
        )
        made.setLegacyPattern(self.legacy)
        return made

    @cached_property
    def _pattern(self) -> CellPattern:
        dictionary, half = dictionary_of(self.dictionary), 0.5 * (self.size_m - 2 * self.margin_m)
        square = grid_indices(self.square_columns, self.square_rows)
        low = square * self.square_m - half
        marker = np.array([np.asarray(corners)[0, :2] for corners in self._opencv.getObjPoints()]) - half
        with_marker = set(map(tuple, np.floor((marker + half) / self.square_m).astype(int)))
        painted = [np.concatenate([low, low + self.square_m], axis=1)]
        black = [np.array([tuple(each) not in with_marker for each in square])]
        for corner, number in zip(marker, np.ravel(np.asarray(self._opencv.getIds())), strict=True):
            cells, dark = marker_cells(dictionary, int(number), corner, self.marker_m)
            painted.append(cells)
            black.append(dark)
        return CellPattern.of_black(self.size_m, np.concatenate(painted), np.concatenate(black))

    def find(self, image: Photograph, name: str = "photograph") -> BoardObservation:
        """As `Board.find`; any part of the board with two markers or more is enough.

        Raises:
            BoardNotFoundError: no marker of the board is in the picture, or the markers are not where this board has
                them; it says if they are where the other pattern has them.
        """
        grey = as_bytes(image)
        index, pixel, numbers = self._detect(grey)
        if not len(index):
            raise BoardNotFoundError(f"{name}: {self._why_nothing(grey, numbers)}")
        margin = 0.5 * (1.0 - self.marker_m / self.square_m)
        return observe_corners(image, index, index.astype(np.float64), [pixel], white_margin=margin, name=name)

    def _detect(self, grey: NDArray[np.uint8]) -> tuple[IntArray, FloatArray, IntArray]:
        """Index (n, 2) and pixel (n, 2) of the corners, and the numbers (m,) of the markers seen."""
        corners, ids, _, marker_ids = cv2.aruco.CharucoDetector(self._opencv).detectBoard(grey)
        numbers = np.zeros(0, dtype=np.int64) if marker_ids is None else np.asarray(marker_ids, np.int64).ravel()
        if ids is None or not len(ids):
            return np.zeros((0, 2), dtype=np.int64), np.zeros((0, 2)), numbers
        row, column = np.divmod(np.asarray(ids, np.int64).ravel(), self.square_columns - 1)
        pixel = np.asarray(corners, np.float64).reshape(-1, 2) - OPENCV_PIXEL_SHIFT
        return np.stack([column, row], axis=-1), pixel, numbers

    def _why_nothing(self, grey: NDArray[np.uint8], numbers: IntArray) -> str:
        other = replace(self, legacy=not self.legacy)
        if len(other._detect(grey)[0]):
            pattern, value = ("legacy", "true") if other.legacy else ("present", "false")
            return f"the ChArUco board has OpenCV's {pattern} pattern; set legacy = {value} in board.toml."
        if not len(numbers):
            return (
                f"no marker of {self.dictionary} is in the picture; check the dictionary in board.toml, or expose more."
            )
        last = len(self._opencv.getIds()) - 1
        if numbers.max() > last:
            return (
                f"marker {numbers.max()} of {self.dictionary} is in the picture, but a board of "
                f"{self.square_columns} x {self.square_rows} squares only has 0 to {last}; is it another board?"
            )
        return (
            f"{len(numbers)} markers of {self.dictionary} are in the picture, but no corner lies between them as on a "
            f"board of {self.square_columns} x {self.square_rows} squares; show more of it, or correct board.toml."
        )
