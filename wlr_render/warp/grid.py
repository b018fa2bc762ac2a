"""Regular grid of points on the panel at which rays are solved, and the interpolation between the points.

Each cell is two triangles, cut from the upper right to the lower left. Values are interpolated linearly over a
triangle; the quadratic remainder is added from second differences of the tangents at the grid points, which are
interpolated linearly too.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wlr_render.mappings import Panel
from wlr_render.numerics.arrays import FloatArray

_TRIANGLES = np.array([[[0, 0], [0, 1], [1, 0]], [[1, 0], [0, 1], [1, 1]]])
"""Corners of the two triangles of a cell, as (column, row) steps from its upper left point."""


@dataclass(frozen=True, eq=False)
class WarpGrid:
    """Points in rows and columns over a panel, the top row first.

    Attributes:
        panel: panel of the pixel positions.
        columns, rows: numbers of points.
        first_px: (2,) panel position of the first point.
        step_px: (2,) distance between neighbouring points.
    """

    panel: Panel
    columns: int
    rows: int
    first_px: FloatArray
    step_px: FloatArray

    @classmethod
    def of_pixels(cls, panel: Panel, size_px: tuple[int, int] | None = None) -> "WarpGrid":
        """Return the pixel centres of a picture (width, height) that covers the panel; the panel's pixels if None."""
        columns, rows = (panel.width_px, panel.height_px) if size_px is None else size_px
        step = panel.size_px / [columns, rows]
        return cls(panel, columns, rows, 0.5 * step, step)

    @classmethod
    def edge_to_edge(cls, panel: Panel, columns: int, rows: int) -> "WarpGrid":
        """Return points from edge to edge of the panel, so that every pixel lies between points."""
        return cls(panel, columns, rows, np.zeros(2), panel.size_px / [columns - 1, rows - 1])

    @property
    def size(self) -> tuple[int, int]:
        """(columns, rows), like a texture's size."""
        return self.columns, self.rows

    def axes_px(self) -> tuple[FloatArray, FloatArray]:
        """Return the panel positions u (columns,) and v (rows,) of the points."""
        u, v = (
            first + step * np.arange(count)
            for first, step, count in zip(self.first_px, self.step_px, self.size, strict=True)
        )
        return u, v

    def panel_pixel(self) -> FloatArray:
        """Return the panel positions of all points, (rows, columns, 2)."""
        return np.stack(np.meshgrid(*self.axes_px()), axis=-1)

    def triangles(self) -> NDArray[np.uint32]:
        """Return the two triangles of each cell, (m, 3) indices of the points, row by row; counter-clockwise."""
        column, row = np.meshgrid(np.arange(self.columns - 1), np.arange(self.rows - 1))
        corner = np.stack([column, row], axis=-1).reshape(-1, 1, 1, 2) + _TRIANGLES
        return np.asarray((corner[..., 1] * self.columns + corner[..., 0]).reshape(-1, 3), np.uint32)

    def interpolated(self, slope_offset: FloatArray, pixel: FloatArray, bends: bool = True) -> FloatArray:
        """Return rays (n, 4) at panel positions (n, 2), as the warp interpolates the grid's rays (4, rows, columns).

        Without `bends`, interpolate linearly, like the triangles of a mesh.

        NaN in a triangle with a NaN ray at a corner.
        """
        place = (pixel - self.first_px) / self.step_px
        cell = np.clip(place.astype(int), 0, np.array(self.size) - 2)
        x, y = (place - cell).T
        is_upper = x + y < 1
        upper, lower = (1 - x - y, x, y, 0 * x), (0 * x, 1 - y, 1 - x, x + y - 1)
        weights = np.where(is_upper, upper, lower)
        mixed = np.where(is_upper, x * y, (1 - x) * (1 - y))
        shares = {"along_rows": -0.5 * x * (1 - x), "along_columns": -0.5 * y * (1 - y), "mixed": mixed}
        differences = _second_differences(slope_offset[:2]) if bends else {}
        rays = np.zeros((len(pixel), 4))
        for weight, (right, down) in zip(weights, ((0, 0), (1, 0), (0, 1), (1, 1)), strict=True):
            column, row = cell[:, 0] + right, cell[:, 1] + down
            counts = weight > 0
            rays[counts] += (weight * slope_offset[:, row, column]).T[counts]
            for name, difference in differences.items():
                rays[:, :2] += (weight * shares[name] * difference[:, row, column]).T
        return rays


def _second_differences(values: FloatArray) -> dict[str, FloatArray]:
    """Return second differences of values (k, rows, columns) at each point, per grid step squared.

    Where a neighbour is missing or beyond the border, use the mean of the adjacent points' differences, else 0.
    A mixed difference is the mean over the cells around the point.
    """
    padded = np.pad(values, ((0, 0), (2, 2), (2, 2)), constant_values=np.nan)
    found = {}
    for name, axis in (("along_rows", 2), ("along_columns", 1)):
        line = np.take(padded, np.arange(2, padded.shape[3 - axis] - 2), 3 - axis)
        difference = np.diff(line, 2, axis=axis)  # at the points, and at one more on either end
        before, about, after = (np.take(difference, np.arange(k, k + values.shape[axis]), axis) for k in range(3))
        found[name] = np.where(np.isnan(about), _mean_of_known([before, after]), about)
    of_cells = np.diff(np.diff(padded[:, 1:-1, 1:-1], axis=1), axis=2)
    found["mixed"] = _mean_of_known(
        [of_cells[:, :-1, :-1], of_cells[:, :-1, 1:], of_cells[:, 1:, :-1], of_cells[:, 1:, 1:]]
    )
    return found


def _mean_of_known(values: list[FloatArray]) -> FloatArray:
    """Return the mean over the first axis without NaN; 0 where all values are NaN."""
    known = np.isfinite(values)
    return np.asarray(np.sum(np.where(known, values, 0.0), axis=0) / np.maximum(known.sum(axis=0), 1))
