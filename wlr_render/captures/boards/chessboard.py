"""Chessboards, detected as a whole by OpenCV; a board of another size than stated is refused."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Annotated

import cv2
import numpy as np
import scipy
from numpy.typing import NDArray

from wlr_render.captures.boards.board import (
    USUAL_TOLERANCES,
    BoardLayout,
    BoardNotFoundError,
    BoardObservation,
    BoardTolerances,
    grid_indices,
)
from wlr_render.captures.boards.board_keys import MARGIN, MOST_FEATURES, BoardLength
from wlr_render.captures.boards.cell_pattern import CellBoard
from wlr_render.captures.boards.corner_observation import observe_corners
from wlr_render.captures.photographs import Photograph, as_bytes
from wlr_render.io.file_records import Key
from wlr_render.lenses.lens_camera import OPENCV_PIXEL_SHIFT
from wlr_render.numerics.arrays import BoolArray, FloatArray

_SECTORS = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
_QUADS = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
_LEAST_HALVED_PX = 200  # least side of a picture that is halved
_WITHIN = (0.2, 0.5, 0.8)  # positions at which a square's colour is sampled, in sides of the square
_ALTERNATING = 0.9  # least share of these positions with the colour of a chessboard
_BEYOND, _ASIDE = 1.3, 0.3  # positions searched for squares beyond the board, in cells from the outer corners
_ALIKE = 0.5  # least contrast of a further row, as a share of the board's


@dataclass(frozen=True, eq=False)
class Chessboard(CellBoard):
    """A chessboard of black and white squares; its features are the inner corners.

    Attributes:
        columns, rows: numbers of inner corners, each one less than the number of squares.
        square_m: side of a square.
        margin_m: white around the squares.
        tolerances: tolerances of the print.
    """

    columns: Annotated[int, Key("corner_columns", least=3, most=MOST_FEATURES)]
    rows: Annotated[int, Key("corner_rows", least=3, most=MOST_FEATURES)]
    square_m: Annotated[float, BoardLength("square")]
    margin_m: Annotated[float, MARGIN]
    tolerances: BoardTolerances = USUAL_TOLERANCES

    @property
    def _layout(self) -> BoardLayout:
        corners = np.array([self.columns, self.rows])
        return BoardLayout(
            corners,
            self.square_m,
            size_m=(corners + 1) * self.square_m + 2 * self.margin_m,
            finest_m=self.square_m,
            title=f"chessboard {self.columns} x {self.rows} inner corners, squares {1e3 * self.square_m:g} mm",
        )

    @property
    def half_turn_symmetric(self) -> bool:
        """True if opposite squares have one colour: columns + rows is even."""
        return (self.columns + self.rows) % 2 == 0

    def _painted(self) -> tuple[FloatArray, BoolArray]:
        square = grid_indices(self.columns + 1, self.rows + 1)
        low = (square - 0.5 * (np.array([self.columns, self.rows]) + 1)) * self.square_m
        return np.concatenate([low, low + self.square_m], axis=1), square.sum(axis=1) % 2 == 0

    def _find(self, image: Photograph) -> BoardObservation:
        """Find the board; all inner corners must be in the picture."""
        grid = self._grid(image)
        if _cross(grid) < 0:
            grid = grid[:, ::-1]
        if not self.half_turn_symmetric and _first_is_light(image, grid):
            # The square after the first corner must be black, like the one at the top left.
            grid = grid[::-1, ::-1]
        sides = _sides_with_more(image, grid)
        if sides:
            raise BoardNotFoundError(
                f"the chessboard seen has more squares than board.toml says ({self.columns} x {self.rows} "
                f"inner corners): they go on at its {' and '.join(sides)}; count the inner corners of the whole board."
            )
        index = self.indices()
        start = grid[index[:, 1], index[:, 0]]
        observation = observe_corners(image, index, index.astype(np.float64), [start])
        if not np.array_equal(np.ptp(observation.index, axis=0), np.ptp(index, axis=0)):
            raise BoardNotFoundError(
                f"of {self.columns} x {self.rows} inner corners a whole outer line does not look like corners; "
                "the chessboard has fewer squares than board.toml says, or its edge is not seen: count the inner "
                "corners of the whole board."
            )
        return replace(observation, ambiguous_half_turn=self.half_turn_symmetric)

    def _grid(self, image: Photograph) -> FloatArray:
        """Return the pixels (rows, columns, 2), in OpenCV's order.

        Raises:
            BoardNotFoundError: no chessboard of this size is detected.
        """
        skipping = False
        for grid in self._detect(as_bytes(image)):
            if _alternates(image, grid):
                return grid
            skipping = True
        if skipping:
            raise BoardNotFoundError(
                f"{self.columns} x {self.rows} inner corners were only found by leaving out others "
                "between them; the chessboard has more squares than board.toml says: count the inner "
                "corners of the whole board."
            )
        raise BoardNotFoundError(
            f"no chessboard of {self.columns} x {self.rows} inner corners is in the picture; show all of its "
            "squares with some white around them, and check the numbers in board.toml."
        )

    def _detect(self, grey: NDArray[np.uint8]) -> Iterator[FloatArray]:
        """Yield the pixels (rows, columns, 2) found by each detector, from the picture's outer corner."""
        shape = (self.columns, self.rows)
        # Pictures that are blurred or from a wide lens may be readable only at half their size.
        for scale in (1, 2):
            if scale > 1:
                if min(grey.shape) < _LEAST_HALVED_PX:
                    return
                grey = np.asarray(cv2.pyrDown(grey), dtype=np.uint8)
            for detector, flags in (
                (cv2.findChessboardCornersSB, _SECTORS),
                (cv2.findChessboardCorners, _QUADS),
            ):
                is_detected, corners = detector(grey, shape, flags=flags)
                if is_detected:
                    grid = np.asarray(corners, dtype=np.float64).reshape(self.rows, self.columns, 2)
                    yield scale * grid - OPENCV_PIXEL_SHIFT


def _cross(grid: FloatArray) -> float:
    """Return a positive number if rows go clockwise of columns, as on a board that is not mirrored."""
    right, down = grid[0, -1] - grid[0, 0], grid[-1, 0] - grid[0, 0]
    return float(right[0] * down[1] - right[1] * down[0])


def _cells(image: Photograph, grid: FloatArray) -> FloatArray:
    """Return nine grey values of each square between four corners, (rows - 1, columns - 1, 9)."""
    samples = []
    for down in _WITHIN:
        for right in _WITHIN:
            top = (1 - right) * grid[:-1, :-1] + right * grid[:-1, 1:]
            bottom = (1 - right) * grid[1:, :-1] + right * grid[1:, 1:]
            samples.append(_grey(image, (1 - down) * top + down * bottom))
    return np.stack(samples, axis=-1)


def _first_is_light(image: Photograph, grid: FloatArray) -> bool:
    middle = np.median(_cells(image, grid), axis=-1)
    row, column = np.indices(middle.shape)
    like = (row + column) % 2 == 0
    return bool(middle[like].mean() > middle[~like].mean())


def _alternates(image: Photograph, grid: FloatArray) -> bool:
    """Return whether the squares between the corners are uniform, and alternately black and white."""
    cells = _cells(image, grid)
    middle = np.median(cells, axis=-1)
    # Black and white are nearly balanced in a window three squares wide, also with mirrored edges.
    threshold = scipy.ndimage.uniform_filter(middle, 3, mode="mirror")
    row, column = np.indices(middle.shape)
    light = (cells > threshold[..., None]) == ((row + column) % 2 == 0)[..., None]
    share = float(np.mean(light))
    return max(share, 1.0 - share) >= _ALTERNATING


def _sides_with_more(image: Photograph, grid: FloatArray) -> list[str]:
    """Return the sides where the checker pattern continues beyond the grid."""
    turned = {"top": grid, "bottom": grid[::-1], "left": grid.swapaxes(0, 1), "right": grid.swapaxes(0, 1)[::-1]}
    return [side for side, lines in turned.items() if _goes_on(image, lines)]


def _goes_on(image: Photograph, grid: FloatArray) -> bool:
    """Return whether squares alternate before the first line of a grid (lines, along, 2) as they do after it.

    The test compares the grey steps across the grid lines at each corner, within the outermost squares and one square
    farther out, where a board of the right size has none.
    """
    inside = _steps(image, _extended(grid, -_ASIDE))
    beyond = _steps(image, _extended(grid, -_BEYOND))
    usable = np.isfinite(beyond) & np.isfinite(inside)
    if usable.sum() < 2:
        return False
    # Beyond the line, black and white are exchanged; off the chessboard, the signs are random or the steps are small.
    strength = -beyond[usable] * np.sign(inside[usable]) / np.median(np.abs(inside[usable]))
    return bool(np.median(strength) > _ALIKE)


def _extended(grid: FloatArray, at: float) -> FloatArray:
    """Return the pixels (along, 2) at `at` lines from the first, on the parabola through the first three."""
    first, second, third = grid[0], grid[1], grid[2]
    return np.asarray(first + at * (-1.5 * first + 2 * second - 0.5 * third) + at**2 * (0.5 * (first + third) - second))


def _steps(image: Photograph, line: FloatArray) -> FloatArray:
    """Return the grey steps (along - 2,) across each inner position of a line; NaN outside the picture."""
    before = line[1:-1] + _ASIDE * (line[:-2] - line[1:-1])
    after = line[1:-1] + _ASIDE * (line[2:] - line[1:-1])
    steps = _grey(image, after) - _grey(image, before)
    return np.asarray(steps * (-1.0) ** np.arange(len(steps)))


def _grey(image: Photograph, pixel: FloatArray) -> FloatArray:
    """Return the grey values (...) at pixels (..., 2); NaN outside the picture."""
    place = np.moveaxis(pixel[..., ::-1] - 0.5, -1, 0)
    return np.asarray(scipy.ndimage.map_coordinates(image, place, np.float64, order=1, mode="constant", cval=np.nan))
