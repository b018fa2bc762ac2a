"""ChArUco boards: a chessboard with a marker in each white square, so that any part of it is identified."""

from dataclasses import dataclass, replace
from typing import Annotated

import cv2
import numpy as np
from numpy.typing import NDArray

from wlr_render.captures.boards.board import (
    MIRRORED,
    USUAL_TOLERANCES,
    BoardLayout,
    BoardNotFoundError,
    BoardObservation,
    BoardTolerances,
    grid_indices,
)
from wlr_render.captures.boards.board_homography import by_homography
from wlr_render.captures.boards.board_keys import MARGIN, BoardLength
from wlr_render.captures.boards.cell_pattern import CellBoard
from wlr_render.captures.boards.corner_observation import observe_corners
from wlr_render.captures.boards.markers import (
    DICTIONARIES,
    LARGEST_DICTIONARIES,
    detect_markers,
    dictionary_of,
    marker_areas,
    marker_cells,
    markers_of_opencv,
)
from wlr_render.captures.photographs import Photograph, as_bytes
from wlr_render.io.file_records import Key
from wlr_render.lenses.lens_camera import OPENCV_PIXEL_SHIFT
from wlr_render.numerics.arrays import BoolArray, FloatArray, IntArray

_LEAST_MARKERS = 4  # fewest markers; fewer may be false detections, or fit any homography
_OTHER_MARKER = 0.2  # largest relative error of a marker's side; small markers are detected a pixel too large or small
_FITTING = 0.1  # largest median error of the board's own markers, in sides of a marker
_SQUARE_OFF = 0.5  # least error of a marker in another square, in sides of a marker


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
        tolerances: tolerances of the print.
    """

    square_columns: Annotated[int, Key(least=2)]
    square_rows: Annotated[int, Key(least=2)]
    square_m: Annotated[float, BoardLength("square")]
    marker_m: Annotated[float, BoardLength("marker")]
    dictionary: Annotated[str, Key(choices=DICTIONARIES)]
    legacy: bool = False
    margin_m: Annotated[float, MARGIN] = 0.0
    tolerances: BoardTolerances = USUAL_TOLERANCES

    @property
    def _layout(self) -> BoardLayout:
        squares = np.array([self.square_columns, self.square_rows])
        return BoardLayout(
            squares - 1,
            self.square_m,
            size_m=squares * self.square_m + 2 * self.margin_m,
            finest_m=self.marker_m / (dictionary_of(self.dictionary).markerSize + 2),
            title=f"ChArUco board {self.square_columns} x {self.square_rows} squares of {1e3 * self.square_m:g} mm, "
            f"markers {self.dictionary} {1e3 * self.marker_m:g} mm{', legacy pattern' if self.legacy else ''}",
        )

    @property
    def _opencv(self) -> cv2.aruco.CharucoBoard:
        made = cv2.aruco.CharucoBoard(
            (self.square_columns, self.square_rows), self.square_m, self.marker_m, dictionary_of(self.dictionary)
        )
        made.setLegacyPattern(self.legacy)
        return made

    def _painted(self) -> tuple[FloatArray, BoolArray]:
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
        return np.concatenate(painted), np.concatenate(black)

    def _find(self, image: Photograph) -> BoardObservation:
        """Find the board; any part of it with two markers or more is enough."""
        grey = as_bytes(image)
        detected = self._detect(grey)
        fault = self._other_sizes(detected) if len(detected.index) else self._why_nothing(grey, detected.numbers)
        if fault is not None:
            raise BoardNotFoundError(fault)
        margin = 0.5 * (1.0 - self.marker_m / self.square_m)
        place = detected.index.astype(np.float64)
        return observe_corners(image, detected.index, place, [detected.pixel], white_margin=margin)

    def _detect(self, grey: NDArray[np.uint8]) -> "_Detected":
        board = self._opencv
        corners, ids, *markers = cv2.aruco.CharucoDetector(board).detectBoard(grey)
        marker, numbers = markers_of_opencv(*markers)
        if (ids is None or not len(ids)) and self._lie_as_here(marker, numbers):
            # In a steep view, OpenCV's check of distances takes the board for another one.
            how = cv2.aruco.CharucoParameters()
            how.checkMarkers = False
            corners, ids, _, _ = cv2.aruco.CharucoDetector(board, how).detectBoard(grey)
        if ids is None or not len(ids):
            return _Detected(np.zeros((0, 2), dtype=np.int64), np.zeros((0, 2)), marker, numbers)
        row, column = np.divmod(np.asarray(ids, np.int64).ravel(), self.square_columns - 1)
        pixel = np.asarray(corners, np.float64).reshape(-1, 2) - OPENCV_PIXEL_SHIFT
        return _Detected(np.stack([column, row], axis=-1), pixel, marker, numbers)

    def _lie_as_here(self, marker: FloatArray, numbers: IntArray) -> bool:
        """Return whether one homography maps this board's markers to all detected corners (m, 4, 2)."""
        on_board = numbers < len(self._opencv.getIds())
        if on_board.sum() < _LEAST_MARKERS:
            return False
        detected = marker[on_board]
        place = np.array(self._opencv.getObjPoints(), dtype=np.float64)[numbers[on_board], :, :2]
        expected = by_homography(place.reshape(-1, 2), detected.reshape(-1, 2), place, cv2.LMEDS)
        if expected is None:
            return False
        side = np.sqrt(marker_areas(detected))
        off = np.linalg.norm(expected - detected, axis=-1).max(axis=1)
        # With the other pattern, or other numbers of squares, some rows fit; others are off by a square or more.
        return bool(np.median(off / np.maximum(side, 1e-9)) < _FITTING and np.all(off < _SQUARE_OFF * side))

    def _other_sizes(self, detected: "_Detected") -> str | None:
        """Describe rows beyond this board's, or another size of its markers; None if all fits."""
        last = len(self._opencv.getIds()) - 1
        if len(detected.numbers) and (highest := int(detected.numbers.max())) > last:
            # An even number of further rows keeps the colours of the squares.
            more = 2 * -(-(highest - last) // self.square_columns)
            if replace(self, square_rows=self.square_rows + more)._lie_as_here(detected.marker, detected.numbers):
                return (
                    f"marker {highest} continues the board, which has 0 to {last} by board.toml; correct square_rows."
                )
        flat = by_homography(detected.pixel, detected.index.astype(np.float64), detected.marker)
        if flat is None or not len(flat):
            return None
        side = float(np.median(np.linalg.norm(flat - np.roll(flat, 1, axis=1), axis=-1)))
        stated = self.marker_m / self.square_m
        if abs(side - stated) < _OTHER_MARKER * stated:
            return None
        return (
            f"markers are {side:.2f} of a square's side, where board.toml has {stated:.2f}; correct marker_mm, the "
            "side of a marker with its black border."
        )

    def _why_nothing(self, grey: NDArray[np.uint8], numbers: IntArray) -> str:
        if len(self._detect(np.ascontiguousarray(grey[:, ::-1])).index):
            return MIRRORED
        other = replace(self, legacy=not self.legacy)
        if len(other._detect(grey).index):
            pattern, value = ("legacy", "true") if other.legacy else ("present", "false")
            return f"the ChArUco board has OpenCV's {pattern} pattern; set legacy = {value} in board.toml."
        if not len(numbers):
            return self._why_no_marker(grey)
        last = len(self._opencv.getIds()) - 1
        if numbers.max() > last:
            return (
                f"marker {numbers.max()} of {self.dictionary} is in the picture, but a board of "
                f"{self.square_columns} x {self.square_rows} squares only has 0 to {last}; is it another board?"
            )
        exchanged = replace(self, square_columns=self.square_rows, square_rows=self.square_columns)
        if len(exchanged._detect(grey).index):
            return (
                f"the markers lie as on a board of {exchanged.square_columns} x {exchanged.square_rows} squares; "
                "exchange square_columns and square_rows in board.toml."
            )
        return (
            f"{len(numbers)} markers of {self.dictionary} are in the picture, but no corner lies between them as on a "
            f"board of {self.square_columns} x {self.square_rows} squares; show more of it, or correct board.toml."
        )

    def _why_no_marker(self, grey: NDArray[np.uint8]) -> str:
        best, most = "", _LEAST_MARKERS - 1
        for name in LARGEST_DICTIONARIES:
            if (count := len(detect_markers(name, grey)[1])) > most:
                best, most = name, count
            if 2 * most > len(self._opencv.getIds()):
                break
        if not best:
            return (
                f"no marker of {self.dictionary} is in the picture; check the dictionary in board.toml, or expose more."
            )
        return (
            f"no marker of {self.dictionary} is in the picture, but {most} of {best}; correct the dictionary in "
            "board.toml."
        )


@dataclass(frozen=True, eq=False)
class _Detected:
    """Parts of a board detected in a picture, pixels from its outer corner.

    Attributes:
        index, pixel: (n, 2) corners.
        marker, numbers: (m, 4, 2) corners and (m,) numbers of markers.
    """

    index: IntArray
    pixel: FloatArray
    marker: FloatArray
    numbers: IntArray
