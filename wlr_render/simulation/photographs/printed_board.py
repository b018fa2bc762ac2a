"""A board as printed and mounted: bowed, twisted, unevenly scaled, with displaced features.

A feature at (x, y, 0) of the design is at (scale * (x, y) + offset, height) of the print, in the same frame. With hx
and hy half the width and height of the features' grid, the height is

    bow * (w (x / hx)^2 + (1 - w) (y / hy)^2) + twist * (x / hx) (y / hy)

less its mean over the features: `bow` is the height of the corners over the middle, and w is the share along x.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy
from numpy.typing import NDArray

from wlr_render.captures.boards.board import Board, RealArray
from wlr_render.numerics.arrays import Float32Array, FloatArray, IntArray
from wlr_render.simulation.photographs.imperfections import BenchImperfections
from wlr_render.simulation.workshop import Workshop

_CELLS = 512  # number of cells along each side of a board; each cell stores its nearest feature


@dataclass(frozen=True, eq=False)
class PrintedBoard:
    """True positions of a board's features.

    Attributes:
        design: the board in board.toml.
        scale: (2,) printed length per length of the design, x and y.
        bow_m, twist_m: `bow` and `twist` above; positive away from the viewer, who is at -z.
        bow_along_x: w above, 0 to 1.
        offset_m: (n, 2) displacement of each feature on the print, in the order of `design.indices()`.
    """

    design: Board
    scale: FloatArray
    bow_m: float
    twist_m: float
    bow_along_x: float
    offset_m: FloatArray

    @classmethod
    def draw(cls, design: Board, sizes: BenchImperfections, rng: np.random.Generator) -> "PrintedBoard":
        """Draw a print of the given sizes, with random signs."""
        larger, longer, bow, twist = rng.choice([-1.0, 1.0], 4)
        along_x = float(rng.uniform(0.2, 0.8))
        return cls(
            design,
            (1.0 + larger * sizes.scale_error) * np.array([1.0, 1.0 + longer * sizes.anisotropy]),
            1e-3 * float(bow) * sizes.bow_mm,
            1e-3 * float(twist) * sizes.twist_mm,
            along_x,
            1e-6 * sizes.dot_error_um * rng.standard_normal((len(design.indices()), 2)),
        )

    @property
    def is_flat(self) -> bool:
        """True if the board has neither bow nor twist."""
        return self.bow_m == self.twist_m == 0.0

    @cached_property
    def points(self) -> FloatArray:
        """True positions (n, 3) of all features, board frame, in the order of `design.indices()`."""
        place = self._designed * self.scale + self.offset_m
        return np.concatenate([place, self.height(place)[:, None]], axis=-1)

    def point_of(self, index: IntArray) -> FloatArray:
        """Return the true positions (..., 3), board frame, of features by (column, row), (..., 2)."""
        all_indices = self.design.indices()
        number = np.zeros(all_indices.max(axis=0) + 1, dtype=np.int64)
        number[tuple(all_indices.T)] = np.arange(len(all_indices))
        return np.asarray(self.points[number[index[..., 0], index[..., 1]]])

    def height(self, on_sheet: RealArray) -> RealArray:
        """Return the height z (...) of the sheet at positions (..., 2) on the sheet, metres."""
        shape = self._shape(on_sheet / self._half_size.astype(on_sheet.dtype))
        return np.asarray(shape - np.asarray(self._mean_height, dtype=on_sheet.dtype))

    def reflectance(self, on_sheet: RealArray, softness_m: RealArray | float = 0.0) -> RealArray:
        """Return the reflectance of the print at positions (..., 2); each feature moves with its neighbourhood."""
        place = on_sheet / self.scale.astype(on_sheet.dtype)
        if np.any(self.offset_m):
            cell = (place / self.design.size_m.astype(on_sheet.dtype) + 0.5) * _CELLS
            # Both turn NaN into a number, so that it can be an index.
            x, y = np.moveaxis(np.fmin(np.fmax(cell, 0), _CELLS - 1).astype(np.intp), -1, 0)
            place = place - self._offset_of_cell[y, x].astype(on_sheet.dtype)
        return self.design.reflectance(place, softness_m)

    @property
    def _designed(self) -> FloatArray:
        return np.asarray(self.design.point_of(self.design.indices())[:, :2])

    @cached_property
    def _half_size(self) -> FloatArray:
        return np.asarray(np.abs(self._designed).max(axis=0))

    @cached_property
    def _mean_height(self) -> float:
        return float(self._shape(self._designed / self._half_size).mean())

    def _shape(self, unit: RealArray) -> NDArray[np.floating]:
        u, v = unit[..., 0], unit[..., 1]
        across, along, twist = (
            np.asarray(size, dtype=unit.dtype)
            for size in (self.bow_m * self.bow_along_x, self.bow_m * (1.0 - self.bow_along_x), self.twist_m)
        )
        return np.asarray(across * u * u + along * v * v + twist * u * v)

    @cached_property
    def _offset_of_cell(self) -> Float32Array:
        """Offset (cells, cells, 2) of the feature nearest to each cell of the design; axes y, x."""
        middle = (np.arange(_CELLS) + 0.5) / _CELLS - 0.5
        cells = np.stack(np.meshgrid(middle, middle), axis=-1) * self.design.size_m
        nearest = scipy.spatial.cKDTree(self._designed).query(cells)[1]
        return np.asarray(self.offset_m[nearest], dtype=np.float32)


@dataclass(frozen=True, eq=False)
class WorkshopBoard(PrintedBoard):
    """A board with errors of print and shape from the second family.

    Attributes:
        workshop: errors of the second family.
    """

    workshop: Workshop

    @classmethod
    def of(cls, design: Board, workshop: Workshop) -> "WorkshopBoard":
        """Return a design as printed, with the errors of a workshop."""
        place = design.point_of(design.indices())[:, :2]
        return cls(design, np.ones(2), 0.0, 0.0, 0.5, workshop.printed_m(place), workshop)

    @property
    def is_flat(self) -> bool:
        """False, because no sheet is flat."""
        return False

    def _shape(self, unit: RealArray) -> NDArray[np.floating]:
        return self.workshop.height_m(np.asarray(unit, dtype=np.float64)).astype(unit.dtype)
