"""Designs of a session: regular spreads of camera places, and the places from which a design may be chosen."""

from dataclasses import dataclass

import numpy as np

from wlr_render.mappings import EyeBox
from wlr_render.numerics.arrays import FloatArray
from wlr_render.simulation import viewpoints

SPREAD, CHOSEN = "spread", "chosen"
"""Families of designs."""
_OFFERED = 37  # number of candidate places in each plane, in addition to a grid of 3 x 3


@dataclass(frozen=True, eq=False)
class Design:
    """Camera places.

    Attributes:
        name: name of the design, e.g. "spread 25".
        unit: (m, 3) places between -1 and 1 across the region of places, see `places_of`.
    """

    name: str
    unit: FloatArray

    def __len__(self) -> int:
        return len(self.unit)


def places_of(unit: FloatArray, eye_box: EyeBox, reach: FloatArray) -> FloatArray:
    """Return camera places (m, 3), device frame.

    The region of places has the depth of the eye box. In the middle plane it extends as far as rays through the eye
    box; off this plane it is smaller, so that rays from its places cross the plane in the same region.

    Args:
        unit: (m, 3) between -1 and 1.
        eye_box: the eye box.
        reach: (2,) largest |tx| and |ty| of the display's rays.
    """
    half = 0.5 * eye_box.size
    beside = half[:2] + half[2] * (1.0 - np.abs(unit[:, 2:])) * reach
    return np.asarray(eye_box.centre + np.concatenate([unit[:, :2] * beside, unit[:, 2:] * half[2]], axis=1))


def spread(eye_box: EyeBox, reach: FloatArray, count: int) -> Design:
    """Return a design in which no two places share a column or a row; see `viewpoints.planar`.

    Args:
        eye_box: the eye box.
        reach: (2,) largest |tx| and |ty| of the display's rays.
        count: number of places.
    """
    away = viewpoints.planar(eye_box, reach, count)[:, :2] - eye_box.centre[:2]
    return Design(f"{SPREAD} {count}", _flat(away / np.abs(away).max(axis=0)))


def _flat(unit: FloatArray) -> FloatArray:
    return np.concatenate([unit, np.zeros((len(unit), 1))], axis=1)


def offered(eye_box: EyeBox, reach: FloatArray, in_depth: bool) -> FloatArray:
    """Return places (n, 3) to choose from, see `Design.unit`: in the middle plane, or in the front and back planes."""
    ends = np.stack(np.meshgrid(*[[-1.0, 0.0, 1.0]] * 2), axis=-1).reshape(-1, 2)
    flat = np.concatenate([spread(eye_box, reach, _OFFERED).unit, _flat(ends)])
    return np.concatenate([flat + [0.0, 0.0, z] for z in ((-1.0, 1.0) if in_depth else (0.0,))])
