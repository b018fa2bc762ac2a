"""The two-size dot board: dots on a square grid, some large, some small, so that any patch tells where it lies.

Board frame: x right along the columns, y down along the rows, z into the board, origin in the middle of the grid
(OpenCV's axes, as a camera sees a board that hangs upright before it). Metres.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class DotBoard:
    """What is printed: dark dots on white.

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

    def reflectance(self, in_board: FloatArray, softness_m: FloatArray | float = 0.0) -> FloatArray:
        """How bright the board is at places (..., 2), x and y: 1 white, 0 dot, NaN beyond its edge.

        Args:
            in_board: (..., 2) metres, board frame.
            softness_m: (...) width of the ramp by which a dot's edge is blurred, e.g. a camera pixel's footprint.
        """
        place = in_board / self.pitch_m + 0.5 * (np.array([self.columns, self.rows]) - 1)
        last = np.array([self.columns, self.rows]) - 1
        nearest = np.clip(np.nan_to_num(np.rint(place)), 0, last).astype(np.int64)
        from_centre = self.pitch_m * np.linalg.norm(place - nearest, axis=-1)
        beyond_edge = from_centre - 0.5 * self.diameter_of(nearest)
        with np.errstate(divide="ignore", invalid="ignore"):
            ramp = np.clip(beyond_edge / softness_m + 0.5, 0.0, 1.0)
        white = np.where(np.asarray(softness_m) > 0, ramp, (beyond_edge > 0).astype(np.float64))
        inside = np.all(np.abs(in_board) <= 0.5 * self.size_m, axis=-1)
        return np.where(inside, white, np.nan)
