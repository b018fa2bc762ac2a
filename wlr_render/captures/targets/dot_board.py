"""The two-size dot board: large and small dots on a square grid; every patch is unique.

Board frame: x right along the columns, y down along the rows, z into the board, origin in the middle of the grid
(OpenCV's axes, as a camera sees a board that hangs upright before it). Metres.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wlr_render.errors import BadInputError
from wlr_render.numerics.arrays import BoolArray, FloatArray

RealArray = NDArray[np.floating[Any]]


@dataclass(frozen=True, eq=False)
class DotBoard:
    """A printed board: dark dots of two sizes on white.

    Attributes:
        pitch_m: distance of neighbouring dots.
        large_m: diameter of large dots.
        small_m: diameter of small dots.
        margin_m: white from the outermost dots' centres to the edge of the board.
        large: (rows, columns) which dots are large.
    """

    pitch_m: float
    large_m: float
    small_m: float
    margin_m: float
    large: BoolArray

    @property
    def rows(self) -> int:
        """Dots along y."""
        return int(self.large.shape[0])

    @property
    def columns(self) -> int:
        """Dots along x."""
        return int(self.large.shape[1])

    @property
    def size_m(self) -> FloatArray:
        """(2,) width and height of the board with its margin."""
        return (np.array([self.columns, self.rows]) - 1) * self.pitch_m + 2 * self.margin_m

    def point_of(self, index: NDArray[np.integer]) -> FloatArray:
        """Centres (..., 3), board frame, of dots by (column, row), (..., 2)."""
        in_plane = (np.asarray(index) - 0.5 * (np.array([self.columns, self.rows]) - 1)) * self.pitch_m
        return np.concatenate([in_plane, np.zeros((*in_plane.shape[:-1], 1))], axis=-1)

    def diameter_of(self, index: NDArray[np.integer]) -> FloatArray:
        """Diameters (...) of dots by (column, row), (..., 2)."""
        index = np.asarray(index)
        return np.where(self.large[index[..., 1], index[..., 0]], self.large_m, self.small_m)

    def indices(self) -> NDArray[np.int64]:
        """(column, row) of all dots, (rows * columns, 2), row by row."""
        column, row = np.meshgrid(np.arange(self.columns), np.arange(self.rows))
        return np.stack([column, row], axis=-1).reshape(-1, 2)

    def reflectance(self, in_board: RealArray, softness_m: RealArray | float = 0.0) -> RealArray:
        """How bright the board is at places (..., 2), x and y: 1 white, 0 dot, NaN beyond its edge.

        Args:
            in_board: (..., 2) metres, board frame.
            softness_m: (...) width of the ramp by which a dot's edge is blurred, e.g. a camera pixel's footprint.
        """
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


class BoardNotFoundError(BadInputError):
    """The photograph shows no board, or too little of it to tell which part; the sentence says which of the two."""


@dataclass(frozen=True, eq=False)
class BoardObservation:
    """Dots of a board identified in one photograph.

    Attributes:
        index: (n, 2) column and row of each dot on the board.
        pixel: (n, 2) where the dot's *centre* is seen, camera pixels from the outer corner of the top-left pixel; the
            bias of a perspective view of a disc is taken out.
        sigma_px: (n,) estimated standard deviation of `pixel` per axis.
        unidentified: number of dots that were seen but not identified.
        disagreeing: number of dots whose size is not what the board has there.
    """

    index: NDArray[np.int64]
    pixel: NDArray[np.float64]
    sigma_px: NDArray[np.float64]
    unidentified: int = 0
    disagreeing: int = 0

    def only(self, rows: NDArray[np.bool_]) -> "BoardObservation":
        """Some of the dots, by mask (n,)."""
        return replace(self, index=self.index[rows], pixel=self.pixel[rows], sigma_px=self.sigma_px[rows])

    def __len__(self) -> int:
        return len(self.index)
