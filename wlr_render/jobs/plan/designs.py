"""Designs of a session: grids of camera places, and sets chosen where the models would be least sure."""

from dataclasses import dataclass

import numpy as np

from wlr_render.mappings import EyeBox
from wlr_render.numerics.arrays import FloatArray, IntArray
from wlr_render.simulation import viewpoints

GRID, SPREAD, CHOSEN = "grid", "spread", "chosen"
"""Families of designs."""
_LEVELS = range(3, 10)
_APART = 0.6  # least distance of places that are chosen together, of half the region's side
_CANDIDATES = 9  # levels of each axis
_FIRST = np.array([[0, 0], [-1, -1], [1, -1], [-1, 1], [1, 1], [0, -1], [0, 1], [-1, 0], [1, 0]], np.float64)


@dataclass(frozen=True, eq=False)
class Design:
    """Camera places on the base plane.

    Attributes:
        name: e.g. "grid 5 x 4".
        unit: (m, 2) between -1 and 1 across the region of places.
    """

    name: str
    unit: FloatArray

    def __len__(self) -> int:
        return len(self.unit)


def spread(eye_box: EyeBox, reach: FloatArray, count: int) -> Design:
    """Design in which no two places share a column or a row; see `viewpoints.planar`.

    Args:
        eye_box: the eye box.
        reach: (2,) largest |tx| and |ty| of the display's rays.
        count: of places.
    """
    away = viewpoints.planar(eye_box, reach, count)[:, :2] - eye_box.centre[:2]
    return Design(f"{SPREAD} {count}", away / np.abs(away).max(axis=0))


def grids(reach: FloatArray, most: int) -> list[Design]:
    """Grids of at most so many places, the smallest first: 3 x 3 to 9 x 9, and those of equal steps along both axes."""
    ratio = float(np.clip(np.sqrt(reach[0] / reach[1]), 0.5, 2.0))
    shapes = {(level, level) for level in _LEVELS}
    for level in np.arange(3.0, 9.01, 0.5):
        columns, rows = (int(np.clip(round(each), 3, 9)) for each in (level * ratio, level / ratio))
        shapes.add((columns, rows))
    sizes = sorted(shapes, key=lambda shape: (shape[0] * shape[1], abs(shape[0] / shape[1] - ratio**2)))
    distinct = {columns * rows: (columns, rows) for columns, rows in reversed(sizes)}
    return [
        Design(f"{GRID} {columns} x {rows}", _grid(columns, rows))
        for count, (columns, rows) in sorted(distinct.items())
        if count <= most
    ]


def _grid(columns: int, rows: int) -> FloatArray:
    """Closer at the edges, as Chebyshev points are: polynomials are least sure there."""
    x, y = (-np.cos(np.pi * (np.arange(count) + 0.5) / count) for count in (columns, rows))
    return np.stack(np.meshgrid(x / x.max(), y / y.max()), axis=-1).reshape(-1, 2)


def candidates() -> FloatArray:
    """Places (n, 2) to choose from."""
    return _grid(_CANDIDATES, _CANDIDATES)


def first_chosen() -> Design:
    """The places with which a chosen design starts."""
    return _chosen(_FIRST)


def with_chosen(design: Design, variance: FloatArray, count: int) -> Design:
    """The design with `count` further places, where the predicted variance (n,) at the `candidates` is largest."""
    offered = candidates()
    return _chosen(np.concatenate([design.unit, offered[largest(variance, offered, design.unit, count)]]))


def _chosen(unit: FloatArray) -> Design:
    return Design(f"{CHOSEN} {len(unit)}", unit)


def largest(variance: FloatArray, offered: FloatArray, taken: FloatArray, count: int) -> IntArray:
    """Indices (count,) of the largest variances, not close to each other nor at a taken place.

    Args:
        variance: (n,) at the offered places.
        offered: (n, 2). taken: (m, 2).
        count: of places.
    """
    found: list[int] = []
    order = np.argsort(-variance)
    for apart in (_APART, 0.5 * _APART, 0.0):
        for number in order:
            far = [np.linalg.norm(offered[number] - offered[other]) > apart for other in found]
            free = np.linalg.norm(taken - offered[number], axis=1).min() > 0.25 * apart
            if len(found) < count and number not in found and free and all(far):
                found.append(int(number))
    return np.array(found, dtype=np.int64)
