"""Designs of a session: lattices of camera places, and the places that a design may be chosen from."""

from dataclasses import dataclass

import numpy as np

from wlr_render.mappings import EyeBox
from wlr_render.numerics.arrays import FloatArray
from wlr_render.simulation import viewpoints

SPREAD, CHOSEN = "spread", "chosen"
"""Families of designs."""
_OFFERED = 37  # candidate places in each plane, in addition to a grid of 3 x 3


@dataclass(frozen=True, eq=False)
class Design:
    """Camera places.

    Attributes:
        name: e.g. "spread 25".
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


def _flat(unit: FloatArray) -> FloatArray:
    return np.concatenate([unit, np.zeros((len(unit), 1))], axis=1)


def offered(eye_box: EyeBox, reach: FloatArray, in_depth: bool) -> FloatArray:
    """Places (n, 3) to choose from, see `Design.unit`: in the middle plane, or in depth at both ends of the eye box."""
    ends = np.stack(np.meshgrid(*[[-1.0, 0.0, 1.0]] * 2), axis=-1).reshape(-1, 2)
    flat = np.concatenate([spread(eye_box, reach, _OFFERED).unit, _flat(ends)])
    return np.concatenate([flat + [0.0, 0.0, z] for z in ((-1.0, 1.0) if in_depth else (0.0,))])
