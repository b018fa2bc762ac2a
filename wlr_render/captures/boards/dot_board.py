"""Two-size dot board: large and small dots on a square grid, in which every patch is unique.

A smooth map around each dot (`lattice_shape`) predicts the position of the dot, the size of a lattice cell there, and
the offset between the centre of a disc's image and the image of the disc's centre. A comparison of dot sizes at all
positions and rotations identifies the part of the board that a lattice of dots shows.
"""

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np
import scipy
from numpy.typing import NDArray

from wlr_render.captures.boards.board import (
    USUAL_TOLERANCES,
    Board,
    BoardLayout,
    BoardNotFoundError,
    BoardObservation,
    BoardTolerances,
    RealArray,
)
from wlr_render.captures.boards.board_keys import BoardLength
from wlr_render.captures.boards.dot_centres import MeasuredDots, measure_dots
from wlr_render.captures.boards.dot_lattice import LEAST_DOTS, DotLattice, find_dots, link_lattices
from wlr_render.captures.boards.lattice_shape import Discs, LatticeShape, smooth_rows
from wlr_render.captures.photographs import Photograph
from wlr_render.io.file_records import Key, Quantity, Rule
from wlr_render.numerics.arrays import BoolArray, FloatArray, IntArray

_TRIES = 3  # number of largest lattices that are compared with the board
_LARGE_ARE_DARKEST = 75  # percentile of nearby contrasts, about the median of the large dots, which blur affects least


_SIZES = Quantity(
    lambda rows, _: np.array([[digit == "1" for digit in row] for row in rows]),
    lambda large, _: ["".join("1" if each else "0" for each in row) for row in large],
)
_ROWS = Rule(
    "texts of equal length, one per row of dots, of 1 for large and 0 for small, both of which occur",
    lambda rows: len({len(row) for row in rows}) == 1 and set("".join(rows)) == {"0", "1"},
)
_LEAD = 3  # least lead of the best position over the second best, in dots; two misread dots cannot make it up
_CHANCE = 2e-3  # largest probability that random dots fit somewhere on the board equally well
_QUARTER = np.array([[0, 1], [-1, 0]])
_MIRROR = np.array([[0, 1], [1, 0]])
_WAYS = [mirror @ np.linalg.matrix_power(_QUARTER, q) for mirror in (np.eye(2, dtype=int), _MIRROR) for q in range(4)]
_PROPER = 4  # number of orientations that are not mirror images


@dataclass(frozen=True, eq=False)
class DotBoard(Board):
    """A printed board: dark dots of two sizes on white.

    Attributes:
        pitch_m: distance of neighbouring dots.
        large_m: diameter of large dots.
        small_m: diameter of small dots.
        margin_m: white from the outermost dots' centres to the edge of the board.
        large: (rows, columns) mask of the large dots.
        tolerances: tolerances of the print.
    """

    pitch_m: Annotated[float, BoardLength("pitch")]
    large_m: Annotated[float, BoardLength("large")]
    small_m: Annotated[float, BoardLength("small")]
    margin_m: Annotated[float, BoardLength("margin")]
    large: Annotated[BoolArray, Key("sizes", _SIZES, type=list, rule=_ROWS)]
    tolerances: BoardTolerances = USUAL_TOLERANCES

    @property
    def rows(self) -> int:
        """Number of dots along y."""
        return int(self.large.shape[0])

    @property
    def columns(self) -> int:
        """Number of dots along x."""
        return int(self.large.shape[1])

    @property
    def _layout(self) -> BoardLayout:
        dots = np.array([self.columns, self.rows])
        return BoardLayout(
            dots,
            self.pitch_m,
            size_m=(dots - 1) * self.pitch_m + 2 * self.margin_m,
            finest_m=self.small_m,
            title=f"two-size dot board {self.columns} x {self.rows}, pitch {1e3 * self.pitch_m:g} mm, dots "
            f"{1e3 * self.large_m:g} and {1e3 * self.small_m:g} mm, margin {1e3 * self.margin_m:g} mm",
        )

    def diameter_of(self, index: NDArray[np.integer]) -> FloatArray:
        """Return the diameters (...) of dots by (column, row), (..., 2)."""
        index = np.asarray(index)
        return np.where(self.large[index[..., 1], index[..., 0]], self.large_m, self.small_m)

    def reflectance(self, in_board: RealArray, softness_m: RealArray | float = 0.0) -> RealArray:
        """Return the reflectance; see `Board.reflectance`."""
        x, y = in_board[..., 0], in_board[..., 1]
        column, row = x / self.pitch_m + 0.5 * (self.columns - 1), y / self.pitch_m + 0.5 * (self.rows - 1)
        # Both turn NaN into a number, so that it can be an index.
        nearest_column = np.fmin(np.fmax(np.rint(column), 0), self.columns - 1)
        nearest_row = np.fmin(np.fmax(np.rint(row), 0), self.rows - 1)
        large = self.large[nearest_row.astype(np.intp), nearest_column.astype(np.intp)]
        from_centre = self.pitch_m * np.sqrt((column - nearest_column) ** 2 + (row - nearest_row) ** 2)
        beyond_edge = from_centre - np.where(large, 0.5 * self.large_m, 0.5 * self.small_m).astype(x.dtype)
        with np.errstate(divide="ignore", invalid="ignore"):
            ramp = np.clip(beyond_edge / softness_m + 0.5, 0.0, 1.0)
        white = np.where(np.asarray(softness_m) > 0, ramp, beyond_edge > 0)
        width, height = self.size_m
        return np.where((np.abs(x) <= 0.5 * width) & (np.abs(y) <= 0.5 * height), white, np.nan)

    def svg_shapes(self) -> list[str]:
        """Return the circles as SVG, millimetres from the top left corner, with the class "large" or "small"."""
        index = self.indices()
        centre_mm = 1e3 * (self.point_of(index)[:, :2] + 0.5 * self.size_m)
        return [
            f'<circle class="{"large" if diameter == self.large_m else "small"}" '
            f'cx="{x:.4f}" cy="{y:.4f}" r="{500.0 * diameter:.4f}"/>'
            for (x, y), diameter in zip(centre_mm, self.diameter_of(index), strict=True)
        ]

    def _find(self, image: Photograph) -> BoardObservation:
        """Find and identify the dots in a photograph.

        Dots whose size differs from the print, or that are off the lattice of their neighbours, are left out.
        """
        dots = find_dots(image)
        lattices = link_lattices(dots)
        if not lattices:
            raise BoardNotFoundError(_why_nothing(image, len(dots)))
        lattices, complaints = lattices[:_TRIES], []
        measured = measure_dots(image, dots, np.concatenate([lattice.dot for lattice in lattices]))
        for lattice in lattices:
            try:
                return _identified(lattice, measured, self)
            except BoardNotFoundError as error:
                complaints.append(error)
        raise complaints[0]


def _identified(lattice: DotLattice, measured: MeasuredDots, board: DotBoard) -> BoardObservation:
    """Identify one lattice; errors lack the photograph's name."""
    smooth, shape = _smooth_part(lattice, measured)
    dot = smooth.dot
    is_large = _large(measured, dot, shape, board)
    index = identify(smooth.index, is_large, board.large)

    on_board = np.all((index >= 0) & (index < [board.columns, board.rows]), axis=-1)
    diameter = board.diameter_of(np.where(on_board[:, None], index, 0))
    agreeing = on_board & (is_large == (diameter == board.large_m))
    discs = Discs(measured.dots.centre[dot], 0.5 * diameter)
    pixel = discs.centroid - shape.centroid_shift(discs.radius_m / board.pitch_m)
    order = np.nonzero(agreeing)[0]
    order = order[np.lexsort(index[order].T)]
    return BoardObservation(index[order], pixel[order], measured.sigma_px[dot][order], discs=discs.only(order))


def _smooth_part(lattice: DotLattice, measured: MeasuredDots) -> tuple[DotLattice, LatticeShape]:
    """Return the dots that agree with the prediction from their neighbours, rejecting the worst first.

    Raises:
        BoardNotFoundError: too few are left.
    """
    lattice = lattice.only(np.isfinite(measured.sigma_px[lattice.dot]))
    rows, shape = smooth_rows(lattice.index, measured.dots.centre[lattice.dot], LEAST_DOTS)
    if shape is None:
        raise BoardNotFoundError(f"only {len(rows)} dots in one piece were seen whole; show more of the board.")
    return lattice.only(rows), shape


def _large(measured: MeasuredDots, dot: IntArray, shape: LatticeShape, board: DotBoard) -> BoolArray:
    """Return the mask (k,) of large dots, by area relative to a lattice cell, a ratio that no view changes."""
    contrast = measured.contrast[dot]
    nearby = np.concatenate([contrast[:, None], contrast[shape.neighbour]], axis=1)
    area: FloatArray = measured.darkness_px2[dot] / np.percentile(nearby, _LARGE_ARE_DARKEST, axis=1)
    between = 0.25 * np.pi * board.large_m * board.small_m / board.pitch_m**2
    return np.asarray(area / shape.cell_px2 > between)


def _why_nothing(image: Photograph, dots: int) -> str:
    low, high = np.percentile(image, [1, 99])
    if high == image.max() > 0.5 * np.iinfo(image.dtype).max and np.mean(image == high) > 0.5:
        return f"most of the picture is at its brightest value, {high:.0f}; expose it less."
    return (
        f"no board is in the picture: {dots} dark spots were seen, no {LEAST_DOTS} of them on a lattice, among grey "
        f"values from {low:.0f} to {high:.0f}; expose it more, or show more of the board."
    )


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
    """Return the number (row shifts, column shifts) of dots that differ from the board or are off the board.

    The first shift moves the last column and row of the fragment onto the first column and row of the board.
    """
    low = turned.min(axis=0)
    columns, rows = turned.max(axis=0) - low + 1
    fragment = np.zeros((rows, columns))  # +1 large, -1 small, 0 no dot
    fragment[turned[:, 1] - low[1], turned[:, 0] - low[0]] = np.where(is_large, 1.0, -1.0)
    board = np.where(board_large, 1.0, -1.0)

    # Number of agreeing minus disagreeing dots on the board, and number of dots on the board.
    balance = scipy.signal.correlate(board, fragment)
    on_board = scipy.signal.correlate(np.ones_like(board), np.abs(fragment))
    return np.asarray(len(turned) - np.rint(0.5 * (balance + on_board)), dtype=np.int64)


def _share_as_good(disagreeing: int, count: int) -> float:
    """Return the share of all size patterns of `count` dots with no more disagreeing dots."""
    as_good = sum(math.comb(count, wrong) for wrong in range(disagreeing + 1))
    # Integers, because floats overflow at a thousand dots.
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
