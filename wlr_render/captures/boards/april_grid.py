"""AprilGrids, as Kalibr prints them: AprilTags with gaps between, and a small black square at each tag's corners."""

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
    flat_points,
    grid_indices,
)
from wlr_render.captures.boards.cell_pattern import CellBoard, CellPattern
from wlr_render.captures.boards.corner_observation import observe_corners
from wlr_render.captures.boards.markers import dictionary_of, marker_cells
from wlr_render.captures.photographs import Photograph, as_bytes
from wlr_render.geometry.lens_camera import OPENCV_PIXEL_SHIFT
from wlr_render.numerics.arrays import FloatArray, IntArray

DICTIONARY = "DICT_APRILTAG_36h11"
_CORNERS = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])  # (column, row) of a tag's corners, clockwise from the top left
_LEAST_TAGS = 2  # one tag alone does not tell which way up the dictionary's tags were printed
_GROWN = (1.0, 1.07, 1.14, 1.21)
"""Of a tag as detected. The small squares touch the tags, and then OpenCV may find the inner edge of a band along the
border in place of the border."""
_SUB_PIXEL = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 30, 0.05)
_CLEARLY = 3.0  # by so much another order of the tags fits better, to be named


@dataclass(frozen=True, eq=False)
class AprilGrid(CellBoard):
    """A grid of AprilTags 36h11; its features are the tags' corners, so that columns and rows come in pairs.

    Attributes:
        tag_columns, tag_rows: numbers of tags.
        tag_m: side of a tag with its black border.
        spacing: gap between tags over `tag_m`.
        border_bits: width of a tag's border in bits; Kalibr prints 2.
        first_id: number of the first tag.
        first_at_bottom: tags are counted from the bottom left upwards, as Kalibr does, instead of from the top left
            downwards.
        margin_m: white around the outermost tags' small squares.
        tolerances: how far the print may differ.
    """

    tag_columns: int
    tag_rows: int
    tag_m: float
    spacing: float = 0.3
    border_bits: int = 2
    first_id: int = 0
    first_at_bottom: bool = True
    margin_m: float = 0.0
    tolerances: BoardTolerances = USUAL_TOLERANCES

    @property
    def gap_m(self) -> float:
        """Width of the gap between tags; the side of the small squares."""
        return self.spacing * self.tag_m

    @property
    def size_m(self) -> FloatArray:
        """(2,) width and height with small squares and margin."""
        tags = np.array([self.tag_columns, self.tag_rows])
        return tags * self.tag_m + (tags + 1) * self.gap_m + 2 * self.margin_m

    @property
    def title(self) -> str:
        """Kind, numbers and sizes in words."""
        return (
            f"AprilGrid {self.tag_columns} x {self.tag_rows} tags 36h11 of {1e3 * self.tag_m:g} mm, spacing "
            f"{self.spacing:g}, border {self.border_bits}, first tag {self.first_id} at the "
            f"{'bottom' if self.first_at_bottom else 'top'} left"
        )

    @property
    def finest_m(self) -> float:
        """Side of a tag's bit, or of a small square."""
        return min(self.tag_m / self._bits, self.gap_m)

    def indices(self) -> IntArray:
        """(column, row) of all tag corners, row by row: two of each for every tag."""
        return grid_indices(2 * self.tag_columns, 2 * self.tag_rows)

    def point_of(self, index: NDArray[np.integer]) -> FloatArray:
        """Corners (..., 3), board frame, by (column, row), (..., 2)."""
        tag, side = np.divmod(np.asarray(index), 2)
        tags = np.array([self.tag_columns, self.tag_rows])
        extent = tags * self.tag_m + (tags - 1) * self.gap_m
        return flat_points(tag * (self.tag_m + self.gap_m) + side * self.tag_m - 0.5 * extent)

    @property
    def _bits(self) -> int:
        """Side of a tag with its border, in bits."""
        return int(dictionary_of(DICTIONARY).markerSize + 2 * self.border_bits)

    def _tag_of(self, number: IntArray) -> IntArray:
        """(n, 2) column and row of tags, from the top left, by number."""
        row, column = np.divmod(number - self.first_id, self.tag_columns)
        return np.stack([column, self.tag_rows - 1 - row if self.first_at_bottom else row], axis=-1)

    @cached_property
    def _pattern(self) -> CellPattern:
        dictionary, count = dictionary_of(DICTIONARY), self.tag_columns * self.tag_rows
        corner = self.point_of(self.indices())[:, :2]
        # Around each corner the small square lies diagonally opposite of the tag.
        low = np.where(self.indices() % 2 == 0, corner - self.gap_m, corner)
        painted, black = [np.concatenate([low, low + self.gap_m], axis=1)], [np.ones(len(low), dtype=bool)]
        numbers = self.first_id + np.arange(count)
        for number, tag in zip(numbers, self._tag_of(numbers), strict=True):
            cells, dark = marker_cells(
                dictionary, int(number), self.point_of(2 * tag)[:2], self.tag_m, self.border_bits
            )
            painted.append(cells)
            black.append(dark)
        return CellPattern.of_black(self.size_m, np.concatenate(painted), np.concatenate(black))

    def find(self, image: Photograph, name: str = "photograph") -> BoardObservation:
        """As `Board.find`; any part of the board with two tags or more is enough.

        Raises:
            BoardNotFoundError: fewer tags of the board are in the picture, or they are not where this board has them.
        """
        grey = as_bytes(image)
        corners, numbers = self._detect(grey)
        on_board = (numbers >= self.first_id) & (numbers < self.first_id + self.tag_columns * self.tag_rows)
        foreign = int((~on_board).sum())
        if on_board.sum() < _LEAST_TAGS:
            raise BoardNotFoundError(f"{name}: {self._why_nothing(int(on_board.sum()), numbers[~on_board])}")
        corners, numbers = corners[on_board], numbers[on_board]
        turn, error = self._turned(numbers, corners)
        other = replace(self, first_at_bottom=not self.first_at_bottom)
        if self.tag_rows > 1 and _CLEARLY * other._turned(numbers, corners)[1] < error:
            where = "bottom-left" if other.first_at_bottom else "top-left"
            raise BoardNotFoundError(
                f'{name}: the AprilGrid is numbered from another corner; set first_tag = "{where}" in board.toml.'
            )
        index = (2 * self._tag_of(numbers)[:, None, :] + np.roll(_CORNERS, -turn, axis=0)).reshape(-1, 2)
        place = self.point_of(index)[:, :2] / self.tag_m
        reach = 0.9 * min(self.border_bits / self._bits, self.spacing)
        middle = corners.mean(axis=1, keepdims=True)
        starts = [(middle + grown * (corners - middle)).reshape(-1, 2) for grown in _GROWN]
        # Corners of large tags may be off by more than the fit's window.
        window = max(
            2, int(0.5 * reach * np.sqrt(np.median([cv2.contourArea(tag.astype(np.float32)) for tag in corners])))
        )
        guess = np.array((starts[0] + OPENCV_PIXEL_SHIFT)[:, None, :], dtype=np.float32)
        nearer = cv2.cornerSubPix(grey, guess, (window, window), (-1, -1), _SUB_PIXEL)
        starts.append(nearer[:, 0].astype(np.float64) - OPENCV_PIXEL_SHIFT)
        return replace(observe_corners(image, index, place, starts, reach, name=name), unidentified=4 * foreign)

    def _detect(self, grey: NDArray[np.uint8]) -> tuple[FloatArray, IntArray]:
        """Corners (n, 4, 2) and numbers (n,) of the tags seen; a number seen twice is dropped."""
        how = cv2.aruco.DetectorParameters()
        how.markerBorderBits = self.border_bits
        corners, ids, _ = cv2.aruco.ArucoDetector(dictionary_of(DICTIONARY), how).detectMarkers(grey)
        numbers = np.zeros(0, dtype=np.int64) if ids is None else np.asarray(ids, np.int64).ravel()
        once = np.array([np.count_nonzero(numbers == number) == 1 for number in numbers], dtype=bool)
        pixel = np.array(corners, dtype=np.float64).reshape(-1, 4, 2) - OPENCV_PIXEL_SHIFT
        return pixel[once], numbers[once]

    def _turned(self, number: IntArray, corners: FloatArray) -> tuple[int, float]:
        """By how many quarter turns the tags are printed against the dictionary, and the median error of the fit in px.

        Printers of grids differ in which way up they print tags; the places of the tags tell.
        """
        tried = []
        for turn in range(4):
            index = 2 * self._tag_of(number)[:, None, :] + np.roll(_CORNERS, -turn, axis=0)
            place = self.point_of(index)[..., :2].reshape(-1, 2) / self.tag_m
            homography, _ = cv2.findHomography(place, corners.reshape(-1, 2))
            if homography is None:
                tried.append((np.inf, turn))
                continue
            there = cv2.perspectiveTransform(place[:, None, :], homography)[:, 0]
            tried.append((float(np.median(np.linalg.norm(there - corners.reshape(-1, 2), axis=1))), turn))
        error, turn = min(tried)
        return turn, error

    def _why_nothing(self, seen: int, foreign: IntArray) -> str:
        last = self.first_id + self.tag_columns * self.tag_rows - 1
        if len(foreign):
            return (
                f"tag {foreign.max()} is in the picture, but a board of {self.tag_columns} x {self.tag_rows} tags has "
                f"{self.first_id} to {last}; is it another board?"
            )
        return (
            f"{seen} tags of the board are in the picture, and {_LEAST_TAGS} are needed; show more of it, expose it "
            "more, or check border_bits in board.toml (Kalibr prints 2, others 1)."
        )
