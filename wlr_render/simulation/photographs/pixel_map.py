"""Interpolation of an expensive quantity, such as a traced ray, to every pixel of an image.

The quantity is computed exactly on a grid of nodes and interpolated by polynomials of degree 5 through the nearest 6 x
6 nodes. It is also computed exactly in the middle of each cell: where the polynomial misses this value, or only some of
corners and middle have light (at the edge of an aperture), every pixel of the cell is computed.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wlr_render.numerics.arrays import BoolArray, Float32Array, FloatArray

Exact = Callable[[FloatArray], tuple[FloatArray, BoolArray]]
"""Positions in the image (n, 2) -> the quantity (n, k) and a mask of light (n,). Values without light may be NaN."""

_SPACING_PX = 16.0  # spacing of the grid, camera pixels
_STENCIL = 6  # nodes of an interpolation along each axis, for degree 5


@dataclass(frozen=True, eq=False)
class PixelMap:
    """A quantity of k components at one position in every pixel.

    Attributes:
        nodes: (k, rows, columns) values on the grid.
        from_rows, from_columns: (height, rows) and (width, columns) interpolation matrices from grid to pixels.
        lit: (height, width) mask of pixels with light.
        alone: (n, 2) (row, column) of pixels that are computed individually.
        alone_value: (n, k) values of these pixels.
    """

    nodes: Float32Array
    from_rows: Float32Array
    from_columns: Float32Array
    lit: BoolArray
    alone: NDArray[np.int64]
    alone_value: Float32Array

    @classmethod
    def sample(cls, exact: Exact, size_px: tuple[int, int], offset: FloatArray, tolerance: FloatArray) -> "PixelMap":
        """Compute the quantity on the grid, and pixel by pixel where interpolation exceeds the tolerance.

        Args:
            exact: function that computes the quantity.
            size_px: width and height of the picture.
            offset: (2,) offset of the positions from the pixels' centres, within half a pixel.
            tolerance: (k,) largest error of each component.
        """
        columns, rows = (_Axis.of(size, shift) for size, shift in zip(size_px, offset, strict=True))
        value, lit_node = _on_grid(exact, columns.node, rows.node)
        middle, lit_middle = _on_grid(exact, columns.middle, rows.middle)
        nodes = np.nan_to_num(value).astype(np.float32)
        guess = rows.to_middle @ nodes @ columns.to_middle.T
        good = (np.abs(guess - middle) <= np.reshape(tolerance, (-1, 1, 1))).all(axis=0)
        count = lit_node[1:, 1:].astype(int) + lit_node[1:, :-1] + lit_node[:-1, 1:] + lit_node[:-1, :-1] + lit_middle
        spread = (count == 5) & good
        alone = np.argwhere(~(spread | (count == 0))[rows.cell[:, None], columns.cell])
        alone_value, lit_alone = exact(alone[:, ::-1] + 0.5 + offset)
        lit = spread[rows.cell[:, None], columns.cell]
        lit[alone[:, 0], alone[:, 1]] = lit_alone
        return cls(nodes, rows.to_pixel, columns.to_pixel, lit, alone, alone_value.astype(np.float32))

    def planes(self) -> Float32Array:
        """Return the quantity (k, height, width) at all pixels; values outside `lit` are meaningless."""
        value = np.asarray(self.from_rows @ self.nodes @ self.from_columns.T, dtype=np.float32)
        value[:, self.alone[:, 0], self.alone[:, 1]] = self.alone_value.T
        return value


@dataclass(frozen=True, eq=False)
class _Axis:
    """One axis of the grid: positions of nodes and cell middles, the cell of each pixel, and interpolation matrices."""

    node: FloatArray
    middle: FloatArray
    cell: NDArray[np.int64]
    to_pixel: Float32Array
    to_middle: Float32Array

    @classmethod
    def of(cls, size_px: int, offset: float) -> "_Axis":
        cells = max(_STENCIL - 1, int(np.ceil(size_px / _SPACING_PX)))
        spacing = size_px / cells
        place = (np.arange(size_px, dtype=np.float64) + 0.5 + offset) / spacing
        middle = np.arange(cells, dtype=np.float64) + 0.5
        return cls(
            np.arange(cells + 1, dtype=np.float64) * spacing,
            middle * spacing,
            np.minimum(place.astype(np.int64), cells - 1),
            _lagrange(cells + 1, place),
            _lagrange(cells + 1, middle),
        )


def _lagrange(nodes: int, place: FloatArray) -> Float32Array:
    """Return the matrix (n, nodes) that interpolates at `place` (n,), by polynomials through the six nearest nodes."""
    start = np.clip(place.astype(np.int64) - _STENCIL // 2 + 1, 0, nodes - _STENCIL)
    local = place - start
    matrix = np.zeros((len(place), nodes), dtype=np.float32)
    for node in range(_STENCIL):
        others = np.delete(np.arange(_STENCIL), node)
        weight = np.prod((local[:, None] - others) / (node - others), axis=1)
        matrix[np.arange(len(place)), start + node] = weight
    return matrix


def _on_grid(exact: Exact, u: FloatArray, v: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Return the quantity (k, rows, columns) and a mask of light (rows, columns)."""
    place = np.stack(np.meshgrid(u, v), axis=-1)
    value, lit = exact(place.reshape(-1, 2))
    return np.moveaxis(value.reshape(*place.shape[:-1], -1), -1, 0), lit.reshape(place.shape[:-1])
