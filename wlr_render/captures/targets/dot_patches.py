"""The pixels around each dot, in batches of patches of one size, with whose they are."""

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from wlr_render.captures.targets.dot_detection import Dots
from wlr_render.numerics.arrays import BoolArray, FloatArray, IntArray

_SIZE_STEP_PX = 4  # patches' half sides are rounded up to multiples, so that there are few sizes
_OUTSIDE = -1


@dataclass(frozen=True, eq=False)
class Patches:
    """Square patches around m dots, each as a row of p pixels.

    Attributes:
        dot: (m,) which dots.
        grey: (m, p).
        x, y: (m, p) pixel centres from the dot's centre.
        foreign: (m, p) in or near another dot.
        outside: (m, p) beyond the edge of the picture.
    """

    dot: IntArray
    grey: FloatArray
    x: FloatArray
    y: FloatArray
    foreign: BoolArray
    outside: BoolArray


def patches_around(
    grey: FloatArray, dots: Dots, which: IntArray, near_px: FloatArray, reach_px: FloatArray
) -> Iterator[Patches]:
    """Patches of those dots that have a place in the picture.

    Args:
        grey: (h, w).
        dots: (n) all that is dark, since a neighbour is not ground; NaN for what was given up.
        which: (m,) the dots that are wanted.
        near_px: (n,) so far beyond its edge a pixel still belongs to a dot.
        reach_px: (n,) so far beyond its edge the patch must reach.
    """
    sound = dots.sound & np.all((dots.centre > 0) & (dots.centre < np.array(grey.shape)[::-1]), axis=-1)
    which = which[sound[which]]
    if not len(which):
        return
    extent = 2.0 * np.sqrt(np.maximum(dots.spread[which, 0, 0], dots.spread[which, 1, 1])) + reach_px[which] + 1.0
    half = _SIZE_STEP_PX * np.ceil(extent / _SIZE_STEP_PX).astype(np.int64)
    border = int(half.max())
    frame = (border, border, border, border)
    padded = cv2.copyMakeBorder(grey, *frame, cv2.BORDER_REPLICATE)
    owner = cv2.copyMakeBorder(
        _owners(grey, dots, near_px, np.nonzero(sound)[0]), *frame, cv2.BORDER_CONSTANT, value=_OUTSIDE
    )
    for size in np.unique(half):
        yield _of_one_size(which[half == size], dots, int(size), padded, owner, border)


def _of_one_size(
    of: IntArray, dots: Dots, half: int, padded: FloatArray, owner: NDArray[np.int32], border: int
) -> Patches:
    steps = np.arange(-half, half + 1)
    u, v = (np.floor(dots.centre[of, axis]).astype(np.int64)[:, None] + steps for axis in (0, 1))
    where = v[:, :, None] + border, u[:, None, :] + border
    x = np.broadcast_to((u + 0.5 - dots.centre[of, :1])[:, None, :], where[0].shape[:1] + (len(steps),) * 2)
    y = np.broadcast_to((v + 0.5 - dots.centre[of, 1:])[:, :, None], x.shape)
    theirs = owner[where].reshape(len(of), -1)
    return Patches(
        dot=of,
        grey=padded[where].reshape(len(of), -1),
        x=x.reshape(len(of), -1),
        y=y.reshape(len(of), -1),
        foreign=(theirs > 0) & (theirs != 1 + of[:, None]),
        outside=theirs == _OUTSIDE,
    )


def _owners(grey: FloatArray, dots: Dots, near_px: FloatArray, which: IntArray) -> NDArray[np.int32]:
    """(h, w) which dot, counted from 1, a pixel is in or near; 0 for ground."""
    owner = np.zeros(grey.shape, np.int32)
    squares, axes = np.linalg.eigh(dots.spread[which])
    angle = np.rad2deg(np.arctan2(axes[:, 1, 0], axes[:, 0, 0])).tolist()
    centre = (dots.centre[which] - 0.5).tolist()
    # The inner parts last: where what is near to two dots overlaps, the nearer one has it.
    for part in (1.0, 0.5, 0.0):
        size = (2.0 * (2.0 * np.sqrt(squares) + part * near_px[which, None])).tolist()
        for place, dot in enumerate(which.tolist()):
            cv2.ellipse(owner, (centre[place], size[place], angle[place]), dot + 1, cv2.FILLED)
    return owner
