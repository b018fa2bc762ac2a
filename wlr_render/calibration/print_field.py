"""Printing errors of a target: a smooth random field on the board, the same at all poses and camera positions."""

from dataclasses import dataclass

import numpy as np

from wlr_render.numerics.arrays import FloatArray

USUAL_FALL, FALLS_DIFFER = 0.3, 0.3
"""Fall of the logarithm of a wave's size with its frequency, per radian in `_UNIT_M`, and its sigma."""
_UNIT_M = 0.1
_FINEST_M = 0.095  # half of the shortest wave: printers err over the width of a hand
_MOST_WAVES = 12  # along an axis
_BEYOND = 1.15  # extent of the board over the extent of its dots


@dataclass(frozen=True)
class PrintField:
    """Errors of dots in the plane of a board, as sums of waves; both axes have waves of their own.

    What a fit of the board's pose to its dots removes, a shift, a turn and a scale, the field has not.

    Attributes:
        columns: (n, waves) change of `observed` by each wave, per metre.
        frequency: (waves,) of each wave, radians in 0.1 m.
        offset: (waves,) logarithm of the prior size of each wave, for an rms error of one metre and no fall.
    """

    columns: FloatArray
    frequency: FloatArray
    offset: FloatArray


def print_field(dot: FloatArray, depth: FloatArray) -> PrintField | None:
    """Return the field of dots (n, 2), metres on their board, seen at depths (n,); None where it has no waves.

    Args:
        dot: places on the board; NaN where unknown.
        depth: of the dots before the base plane, metres.
    """
    if not np.isfinite(dot).all() or len(np.unique(dot, axis=0)) < 2 * _BEYOND:
        return None
    middle, half = 0.5 * (dot.max(axis=0) + dot.min(axis=0)), 0.5 * _BEYOND * np.ptp(dot, axis=0)
    if half.min() <= 0:
        return None
    counts = np.clip(np.ceil(2.0 * half / _FINEST_M), 2, _MOST_WAVES).astype(int)
    orders = np.stack(np.meshgrid(*(np.arange(1, count + 1) for count in counts)), axis=-1).reshape(-1, 2)
    along = np.pi * orders / (2.0 * half)
    place = dot - middle
    waves = np.sin((place[:, :1] + half[0]) * along[:, 0]) * np.sin((place[:, 1:] + half[1]) * along[:, 1])
    affine = np.column_stack([np.ones(len(place)), place / half])
    waves = waves - affine @ np.linalg.lstsq(affine, waves, rcond=None)[0]
    frequency = np.linalg.norm(along, axis=1) * _UNIT_M
    offset = -0.5 * np.log(0.25 * np.sum(np.exp(-2.0 * USUAL_FALL * frequency)))
    return PrintField(waves / depth[:, None], frequency, np.full(len(frequency), offset))
