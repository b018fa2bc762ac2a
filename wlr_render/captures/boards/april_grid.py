"""AprilGrids as printed by Kalibr: AprilTags with gaps, and a small black square at each corner of a tag."""

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
    flat_points,
)
from wlr_render.captures.boards.board_homography import by_homography
from wlr_render.captures.boards.board_keys import MARGIN, BoardLength
from wlr_render.captures.boards.cell_pattern import CellBoard
from wlr_render.captures.boards.corner_observation import observe_corners
from wlr_render.captures.boards.markers import detect_markers, dictionary_of, marker_areas, marker_cells
from wlr_render.captures.photographs import Photograph, as_bytes
from wlr_render.io.file_records import Key, Quantity, Rule
from wlr_render.lenses.lens_camera import OPENCV_PIXEL_SHIFT
from wlr_render.numerics.arrays import BoolArray, FloatArray, IntArray

DICTIONARY = "DICT_APRILTAG_36h11"
_CORNERS = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])  # (column, row) of a tag's corners, clockwise from the top left
_LEAST_TAGS = 2  # fewest tags; a single tag does not show the orientation in which the tags were printed
_GROWN = (1.0, 1.07, 1.14, 1.21)
"""Factors by which a detected tag is enlarged. The small squares touch the tags, so that OpenCV may detect the inner
edge of a band along the border instead of the border."""
_SUB_PIXEL = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 30, 0.05)  # steps, pixels; refined by the corner fit
_CLEARLY = 3.0  # factor by which another arrangement of the tags must fit better to be reported
_FITTING = 0.02  # error of the right arrangement without lens distortion, in sides of a tag
_MOST_COLUMNS = 60  # most columns of the arrangements that are compared
_USUAL_BORDERS = (2, 1)  # border widths in bits: Kalibr's, and other programs'
_MANY_MORE = 1.5  # factor by which another border must find more tags to be reported
_OTHER_FAMILIES = ("DICT_APRILTAG_36h10", "DICT_APRILTAG_25h9", "DICT_APRILTAG_16h5")
_LEAST_OF_OTHERS = 4  # fewest tags of another family; fewer may be chance
_LEAST_SPACINGS = 8  # fewest pairs of tags for a median spacing
_SPACING_ERROR = 0.01  # error of the spacing measured through a lens of 90 degrees
_MOST_PRINT_ERRORS = 10.0  # largest shift of corners by another spacing, in standard deviations of the print


_FIRST_TAGS = ("top-left", "bottom-left")
_AT_BOTTOM = Quantity(lambda text, _: text == _FIRST_TAGS[1], lambda is_bottom, _: _FIRST_TAGS[is_bottom])
_SPACING = Rule("the gap between tags over their side, between 0 and 1", lambda value: 0 < value < 1)


@dataclass(frozen=True, eq=False)
class AprilGrid(CellBoard):
    """A grid of AprilTags 36h11; the features are the tags' corners, two columns and two rows for each tag.

    Attributes:
        tag_columns, tag_rows: numbers of tags.
        tag_m: side of a tag with its black border.
        spacing: gap between tags over `tag_m`.
        border_bits: width of a tag's border in bits; Kalibr prints 2.
        first_id: number of the first tag.
        first_at_bottom: tags are counted from the bottom left upwards, as Kalibr does, instead of from the top left
            downwards.
        margin_m: white around the outermost tags' small squares.
        tolerances: tolerances of the print.
    """

    tag_columns: Annotated[int, Key(least=1)]
    tag_rows: Annotated[int, Key(least=1)]
    tag_m: Annotated[float, BoardLength("tag")]
    spacing: Annotated[float, Key(rule=_SPACING)] = 0.3
    border_bits: Annotated[int, Key(least=1, most=10)] = 2
    first_id: int = 0
    first_at_bottom: Annotated[bool, Key("first_tag", _AT_BOTTOM, type=str, choices=_FIRST_TAGS)] = True
    margin_m: Annotated[float, MARGIN] = 0.0
    tolerances: BoardTolerances = USUAL_TOLERANCES

    @property
    def gap_m(self) -> float:
        """Width of the gap between tags, and side of the small squares."""
        return self.spacing * self.tag_m

    @property
    def _layout(self) -> BoardLayout:
        tags = np.array([self.tag_columns, self.tag_rows])
        return BoardLayout(
            2 * tags,
            self.tag_m,
            size_m=tags * self.tag_m + (tags + 1) * self.gap_m + 2 * self.margin_m,
            finest_m=min(self.tag_m / self._bits, self.gap_m),
            title=f"AprilGrid {self.tag_columns} x {self.tag_rows} tags 36h11 of {1e3 * self.tag_m:g} mm, spacing "
            f"{self.spacing:g}, border {self.border_bits}, first tag {self.first_id} at the "
            f"{'bottom' if self.first_at_bottom else 'top'} left",
        )

    def point_of(self, index: NDArray[np.integer]) -> FloatArray:
        """Return the corners (..., 3), board frame, by (column, row), (..., 2); each tag has two columns and rows."""
        tag, side = np.divmod(np.asarray(index), 2)
        tags = np.array([self.tag_columns, self.tag_rows])
        extent = tags * self.tag_m + (tags - 1) * self.gap_m
        return flat_points(tag * (self.tag_m + self.gap_m) + side * self.tag_m - 0.5 * extent)

    @property
    def _bits(self) -> int:
        """Side of a tag with border, in bits."""
        return int(dictionary_of(DICTIONARY).markerSize + 2 * self.border_bits)

    def _tag_of(self, number: IntArray) -> IntArray:
        """Return the (column, row) of tags by number, (n, 2), from the top left."""
        row, column = np.divmod(number - self.first_id, self.tag_columns)
        return np.stack([column, self.tag_rows - 1 - row if self.first_at_bottom else row], axis=-1)

    def _painted(self) -> tuple[FloatArray, BoolArray]:
        dictionary, count = dictionary_of(DICTIONARY), self.tag_columns * self.tag_rows
        corner = self.point_of(self.indices())[:, :2]
        # The small square touches the tag's corner from diagonally outside.
        low = np.where(self.indices() % 2 == 0, corner - self.gap_m, corner)
        painted, black = [np.concatenate([low, low + self.gap_m], axis=1)], [np.ones(len(low), dtype=bool)]
        numbers = self.first_id + np.arange(count)
        for number, tag in zip(numbers, self._tag_of(numbers), strict=True):
            cells, dark = marker_cells(
                dictionary, int(number), self.point_of(2 * tag)[:2], self.tag_m, self.border_bits
            )
            painted.append(cells)
            black.append(dark)
        return np.concatenate(painted), np.concatenate(black)

    def _find(self, image: Photograph) -> BoardObservation:
        """Find the board; any part of it with two tags or more is enough."""
        grey = as_bytes(image)
        corners, numbers = self._detect(grey)
        on_board = self._has(numbers)
        self._refuse_other_design(grey, numbers)
        if on_board.sum() < _LEAST_TAGS:
            raise BoardNotFoundError(self._why_nothing(grey, numbers))
        others = corners[~on_board], numbers[~on_board]
        corners, numbers = corners[on_board], numbers[on_board]
        turn, error = self._turned(numbers, corners)
        self._refuse_other_layout(numbers, corners, error)
        self._refuse_further_tags(others, numbers, corners, turn)
        index, place = self._corner_indices(numbers, turn), self._places(numbers, turn)
        reach = 0.9 * min(self.border_bits / self._bits, self.spacing)
        observation = observe_corners(image, index, place, _starts(grey, corners, reach), reach)
        self._refuse_other_spacing(observation)
        return observation

    def _has(self, numbers: IntArray) -> BoolArray:
        """Return the mask (n,) of the tag numbers that belong to this board."""
        return np.asarray((numbers >= self.first_id) & (numbers <= self._last_id))

    @property
    def _last_id(self) -> int:
        return self.first_id + self.tag_columns * self.tag_rows - 1

    def _detect(self, grey: NDArray[np.uint8], family: str = DICTIONARY) -> tuple[FloatArray, IntArray]:
        """Return the corners (n, 4, 2) and numbers (n,) of the detected tags; a number that occurs twice is dropped."""
        pixel, numbers = detect_markers(family, grey, self.border_bits)
        once = np.array([np.count_nonzero(numbers == number) == 1 for number in numbers], dtype=bool)
        return pixel[once], numbers[once]

    def _corner_indices(self, number: IntArray, turn: int) -> IntArray:
        """Return the (column, row) of tag corners, (4 n, 2), for tags (n,) printed with `turn` quarter turns."""
        return np.asarray(2 * self._tag_of(number)[:, None, :] + np.roll(_CORNERS, -turn, axis=0)).reshape(-1, 2)

    def _places(self, number: IntArray, turn: int) -> FloatArray:
        """Return the positions (4 n, 2) of tag corners, in sides of a tag."""
        return self.point_of(self._corner_indices(number, turn))[:, :2] / self.tag_m

    def _turned(self, number: IntArray, corners: FloatArray) -> tuple[int, float]:
        """Return the quarter turns of the printed tags relative to the dictionary, and the fit's median error in px.

        Programs that print grids differ in the orientation of the tags; the tags' positions reveal it.
        """
        tried = []
        for turn in range(4):
            place = self._places(number, turn)
            there = by_homography(place, corners.reshape(-1, 2), place)
            off = np.inf if there is None else np.median(np.linalg.norm(there - corners.reshape(-1, 2), axis=1))
            tried.append((float(off), turn))
        error, turn = min(tried)
        return turn, error

    def _refuse_other_design(self, grey: NDArray[np.uint8], numbers: IntArray) -> None:
        """Refuse detected tags with another border width or numbers of another board."""
        on_board = self._has(numbers)
        count, foreign = int(on_board.sum()), numbers[~on_board]
        if len(foreign) > count:
            raise BoardNotFoundError(
                f"tag {foreign.max()} is in the picture, but a board of {self.tag_columns} x {self.tag_rows} tags has "
                f"{self.first_id} to {self._last_id}; is it another board, or 'first_id' another number?"
            )
        if count == self.tag_columns * self.tag_rows:
            return
        for bits in set(_USUAL_BORDERS) - {self.border_bits}:
            other = replace(self, border_bits=bits)
            with_other = int(other._has(other._detect(grey)[1]).sum())
            if with_other >= max(_LEAST_TAGS, _MANY_MORE * count):
                raise BoardNotFoundError(
                    f"{with_other} tags of the board are found if their borders are {bits} bits wide, {count} with "
                    f"border_bits = {self.border_bits}; set border_bits = {bits} in board.toml."
                )

    def _refuse_other_layout(self, numbers: IntArray, corners: FloatArray, error: float) -> None:
        """Refuse tags that another arrangement fits clearly better than this board's.

        Args:
            numbers, corners: (n,) numbers and (n, 4, 2) corners of the detected tags.
            error: error of this board's arrangement, from `_turned`.
        """
        side = _side(corners)
        if error < _FITTING * side or self.tag_columns * self.tag_rows == 1:
            return
        orders = [
            replace(self, tag_columns=columns, first_at_bottom=at_bottom)
            for columns in range(1, min(int(numbers.max()) + 1, _MOST_COLUMNS) + 1)
            for at_bottom in (self.first_at_bottom, not self.first_at_bottom)
        ]
        tried = [*orders, *(replace(self, first_id=self.first_id + shift) for shift in range(1, self.tag_columns))]
        errors = [other._turned(numbers, corners)[1] for other in tried]
        best = int(np.argmin(errors))
        if _CLEARLY * errors[best] >= error:
            return
        other = tried[best]
        if other.first_id != self.first_id:
            raise BoardNotFoundError(
                "the tags lie as on a board whose first tag has another number; correct first_id in board.toml."
            )
        where = f'set first_tag = "{_FIRST_TAGS[other.first_at_bottom]}" in board.toml'
        if other.tag_columns == self.tag_columns:
            raise BoardNotFoundError(f"the AprilGrid is numbered from another corner; {where}.")
        remedy = "exchange" if other.tag_columns == self.tag_rows else "correct"
        raise BoardNotFoundError(
            f"the tags lie as on a board of {other.tag_columns} columns, where board.toml has {self.tag_columns}; "
            f"{remedy} tag_columns and tag_rows"
            + (f", and {where}." if other.first_at_bottom != self.first_at_bottom else ".")
        )

    def _refuse_further_tags(
        self, foreign: tuple[FloatArray, IntArray], numbers: IntArray, corners: FloatArray, turn: int
    ) -> None:
        """Refuse tags with foreign numbers that continue the board's arrangement.

        Args:
            foreign: corners (m, 4, 2) and numbers (m,) of tags that this board lacks.
            numbers, corners, turn: tags of this board, and their quarter turns.
        """
        if not len(foreign[1]):
            return
        place = self._places(foreign[1], turn).reshape(-1, 4, 2)
        expected = by_homography(self._places(numbers, turn), corners.reshape(-1, 2), place)
        if expected is None or np.median(np.linalg.norm(expected - foreign[0], axis=-1)) > 0.5 * _side(corners):
            return
        raise BoardNotFoundError(
            f"tag {foreign[1].max()} continues the board, which has {self.first_id} to {self._last_id} by board.toml; "
            "correct tag_rows or first_id."
        )

    def _refuse_other_spacing(self, observation: BoardObservation) -> None:
        """Refuse gaps between the tags that clearly differ from `spacing`."""
        measured = _measured_spacings(observation)
        if len(measured) < _LEAST_SPACINGS:
            return
        spacing = float(np.median(measured))
        off_m = 0.5 * self.tag_m * abs(1 - (1 + spacing) / (1 + self.spacing))
        print_error_m = max(self.tolerances.print_error_m, USUAL_TOLERANCES.print_error_m)
        if off_m < _MOST_PRINT_ERRORS * print_error_m or abs(spacing - self.spacing) < _SPACING_ERROR:
            return
        raise BoardNotFoundError(
            f"the gaps between tags are {spacing:.3f} of a tag's side, where board.toml has spacing = "
            f"{self.spacing:g}: corners lie {1e6 * off_m:.0f} um from their places, with print_error_um = "
            f"{1e6 * self.tolerances.print_error_m:g}; measure tag_mm and spacing again."
        )

    def _why_nothing(self, grey: NDArray[np.uint8], numbers: IntArray) -> str:
        count = int(self._has(numbers).sum())
        if len(self._detect(np.ascontiguousarray(grey[:, ::-1]))[1]) >= max(_LEAST_TAGS, count + 1):
            return MIRRORED
        for family in _OTHER_FAMILIES:
            for bits in _USUAL_BORDERS:
                foreign = replace(self, border_bits=bits)._detect(grey, family)[1]
                if len(foreign) >= _LEAST_OF_OTHERS:
                    return (
                        f"{len(foreign)} tags of {family} are in the picture, and boards here have {DICTIONARY}; print "
                        "a board of these."
                    )
        return (
            f"{count} tags of the board are in the picture, and {_LEAST_TAGS} are needed; show more of it, expose it "
            "more, or check border_bits in board.toml (Kalibr prints 2, others 1)."
        )


def _side(corners: FloatArray) -> float:
    """Return the median side of tags, pixels, from their corners (n, 4, 2)."""
    return float(np.sqrt(np.median(marker_areas(corners))))


def _starts(grey: NDArray[np.uint8], corners: FloatArray, reach: float) -> list[FloatArray]:
    """Return initial pixels (4 n, 2) of the corners: as detected, of enlarged tags, and refined by OpenCV.

    Args:
        grey: the picture.
        corners: (n, 4, 2) as detected.
        reach: reach of the corner fit, in sides of a tag.
    """
    middle = corners.mean(axis=1, keepdims=True)
    starts = [(middle + grown * (corners - middle)).reshape(-1, 2) for grown in _GROWN]
    # Corners of large tags may be off by more than the fit's window.
    window = max(2, int(0.5 * reach * _side(corners)))
    guess = np.array((starts[0] + OPENCV_PIXEL_SHIFT)[:, None, :], dtype=np.float32)
    nearer = cv2.cornerSubPix(grey, guess, (window, window), (-1, -1), _SUB_PIXEL)
    return [*starts, nearer[:, 0].astype(np.float64) - OPENCV_PIXEL_SHIFT]


def _measured_spacings(observation: BoardObservation) -> FloatArray:
    """Return the gap (n,) of each pair of neighbouring tags, in sides of a tag, from the cross-ratio of their corners.

    The cross-ratio of four corners in a line does not depend on the perspective.
    """
    at = {tuple(index): pixel for index, pixel in zip(observation.index.tolist(), observation.pixel, strict=True)}
    ratios = []
    for column, row in at:
        for right, down in ((1, 0), (0, 1)):
            line = [at.get((column + k * right, row + k * down)) for k in range(4)]
            first_of_tag = (column if right else row) % 2 == 0
            if first_of_tag and all(pixel is not None for pixel in line):
                a, b, c, d = np.array(line)
                length = np.linalg.norm([c - a, d - b, d - a, c - b], axis=1)
                ratios.append(length[0] * length[1] / (length[2] * length[3]))
    return np.asarray(np.sqrt(1 + 1 / (np.maximum(ratios, 1 + 1e-6) - 1)) - 1)
