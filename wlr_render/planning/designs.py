"""Designs of a session: grids and lattices of camera places, and the places that a design may be chosen from."""

from dataclasses import dataclass

import numpy as np

from wlr_render.mappings import EyeBox
from wlr_render.numerics.arrays import FloatArray
from wlr_render.simulation import viewpoints

GRID, SPREAD, CHOSEN = "grid", "spread", "chosen"
"""Families of designs."""
_LEVELS = range(3, 10)
_JITTER = 0.1  # share of half the box: about a screw's pitch of 1 to 2 mm, and small against the steps of a grid
_OFFERED = 37  # candidate places in each plane, in addition to a grid of 3 x 3


@dataclass(frozen=True, eq=False)
class Design:
    """Camera places.

    Attributes:
        name: e.g. "grid 5 x 4".
        unit: (m, 3) between -1 and 1 across the region of places, see `places_of`.
    """

    name: str
    unit: FloatArray

    def __len__(self) -> int:
        return len(self.unit)


def places_of(unit: FloatArray, eye_box: EyeBox, reach: FloatArray) -> FloatArray:
    """Camera places (m, 3), device frame.

    The region of places has the depth of the eye box. In the middle plane it ends where rays through the eye box do;
    before and behind it is smaller, so that rays from its places meet the middle plane in the same region.

    Args:
        unit: (m, 3) between -1 and 1.
        eye_box: the eye box.
        reach: (2,) largest |tx| and |ty| of the display's rays.
    """
    half = 0.5 * eye_box.size
    beside = half[:2] + half[2] * (1.0 - np.abs(unit[:, 2:])) * reach
    return np.asarray(eye_box.centre + np.concatenate([unit[:, :2] * beside, unit[:, 2:] * half[2]], axis=1))


def spread(eye_box: EyeBox, reach: FloatArray, count: int) -> Design:
    """Design in which no two places share a column or a row; see `viewpoints.planar`.

    Args:
        eye_box: the eye box.
        reach: (2,) largest |tx| and |ty| of the display's rays.
        count: of places.
    """
    away = viewpoints.planar(eye_box, reach, count)[:, :2] - eye_box.centre[:2]
    return Design(f"{SPREAD} {count}", _flat(away / np.abs(away).max(axis=0)))


def grids(reach: FloatArray, most: int) -> list[Design]:
    """Return grids of at most `most` places, smallest first: 3 x 3 to 9 x 9, and with equal steps on both axes."""
    ratio = float(np.clip(np.sqrt(reach[0] / reach[1]), 0.5, 2.0))
    shapes = {(level, level) for level in _LEVELS}
    for level in np.arange(3.0, 9.01, 0.5):
        columns, rows = (int(np.clip(round(each), 3, 9)) for each in (level * ratio, level / ratio))
        shapes.add((columns, rows))
    sizes = sorted(shapes, key=lambda shape: (shape[0] * shape[1], abs(shape[0] / shape[1] - ratio**2)))
    distinct = {columns * rows: (columns, rows) for columns, rows in reversed(sizes)}
    return [
        Design(f"{GRID} {columns} x {rows}", _jittered(_grid(columns, rows)))
        for count, (columns, rows) in sorted(distinct.items())
        if count <= most
    ]


def _grid(columns: int, rows: int) -> FloatArray:
    """Closer at the edges, as Chebyshev points are: polynomials are least sure there."""
    x, y = (-np.cos(np.pi * (np.arange(count) + 0.5) / count) for count in (columns, rows))
    return _flat(np.stack(np.meshgrid(x / x.max(), y / y.max()), axis=-1).reshape(-1, 2))


def _jittered(unit: FloatArray) -> FloatArray:
    """Move the places (m, 3) of a grid at random within their plane; the grid still reaches from -1 to 1.

    On a regular grid a screw error at one reading of an axis would affect a whole row or column.
    """
    moved = unit[:, :2] + np.random.default_rng(len(unit)).uniform(-_JITTER, _JITTER, (len(unit), 2))
    low, high = moved.min(axis=0), moved.max(axis=0)
    return _flat(2.0 * (moved - low) / (high - low) - 1.0)


def _flat(unit: FloatArray) -> FloatArray:
    return np.concatenate([unit, np.zeros((len(unit), 1))], axis=1)


def offered(eye_box: EyeBox, reach: FloatArray, in_depth: bool) -> FloatArray:
    """Places (n, 3) to choose from, see `Design.unit`: in the middle plane, or in depth at both ends of the eye box."""
    flat = np.concatenate([spread(eye_box, reach, _OFFERED).unit, _grid(3, 3)])
    return np.concatenate([flat + [0.0, 0.0, z] for z in ((-1.0, 1.0) if in_depth else (0.0,))])
