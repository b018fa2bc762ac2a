"""Consistency of decoded positions with those of neighbouring camera pixels."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from wlr_render.errors import BadInputError
from wlr_render.numerics.arrays import FloatArray

Mask = NDArray[np.bool_]
Slices = tuple[slice, slice]

_NEEDED = 3  # neighbours that agree; fewer at the border of the picture
_FEW = 400  # pairs that say nothing about the order of photographs


def neighbour_slices(dx: int, dy: int) -> tuple[Slices, Slices]:
    """Slices of a picture and of the neighbours at (dx, dy) of its pixels; dx is -1, 0 or 1, dy is 0 or 1."""
    here, there = {0: (slice(None), slice(None)), 1: (slice(None, -1), slice(1, None))}[abs(dx)][
        :: 1 if dx >= 0 else -1
    ]
    above, below = {0: (slice(None), slice(None)), 1: (slice(None, -1), slice(1, None))}[dy]
    return (above, here), (below, there)


def _pairs() -> Iterator[tuple[Slices, Slices]]:
    """Each pair of neighbours, diagonal ones too, once."""
    for offset in ((1, 0), (0, 1), (1, 1), (-1, 1)):
        yield neighbour_slices(*offset)


def typical_step(position: FloatArray, valid: Mask) -> float:
    """Median over neighbours, side by side, of how far they lie apart on the panel, in panel pixels; 0 for no pairs.

    Args:
        position: (2, h, w).
        valid: (h, w) which count.
    """
    steps = []
    for offset in ((1, 0), (0, 1)):
        here, there = neighbour_slices(*offset)
        apart = np.abs(position[:, *there] - position[:, *here]).max(axis=0)
        steps.append(apart[valid[here] & valid[there]])
    found = np.concatenate(steps)
    return float(np.median(found)) if found.size else 0.0


def agrees_with_neighbours(position: FloatArray, valid: Mask, step: float) -> Mask:
    """(h, w) where at least three neighbours, and half of the valid ones, lie about one step away at most.

    Raises:
        BadInputError: most neighbours of most pixels lie elsewhere.
    """
    tolerance = 1 + 3 * step
    there_are, agreeing, present = (np.zeros(valid.shape, dtype=np.uint8) for _ in range(3))
    for here, there in _pairs():
        both = valid[here] & valid[there]
        agree = both & np.all(np.abs(position[:, *there] - position[:, *here]) <= tolerance, axis=0)
        for side in (here, there):
            there_are[side] += 1
            present[side] += both
            agreeing[side] += agree
    _check_smooth(int(agreeing.sum()), int(present.sum()))
    return (agreeing >= np.minimum(_NEEDED, there_are)) & (2 * agreeing >= present)


def _check_smooth(agreeing: int, present: int) -> None:
    if present >= _FEW and agreeing < 0.5 * present:
        raise BadInputError(
            f"Neighbouring pixels contradict each other in {1 - agreeing / present:.0%} of what was decoded: the "
            "photographs are not in the order of showing, the camera moved between them, or they show another code or "
            "panel size."
        )
