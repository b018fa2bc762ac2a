"""Detection of dark dots of any size on a lighter background, in unevenly lit photographs.

A morphological closing estimates the ground under the dots; a dot is a region below it. Each level of a pyramid detects
dots of up to twice the size of the level before.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from wlr_render.numerics.arrays import FloatArray

FloatImage = NDArray[np.float32]

_LEVELS = 5  # pyramid levels: dots of up to 24 px on the finest, 380 px on the coarsest
_KERNEL_PX = 25  # side of the closing's square, on each level
LEAST_AREA_PX = 8.0
"""Least area of a dot on the finest level."""
_LEAST_AREA_BEYOND_PX = 60.0  # least area on coarser levels: the level before is better at smaller dots
_FULLNESS = (0.8, 1.15)  # range of area over the area of the ellipse with the same second moments: 1 for any ellipse
_LEAST_AXES_RATIO = 0.3  # least ratio of a dot's axes: a board tilted by 70 degrees
_OVER_NOISE = 4.0  # least depth of a dot, in usual differences of closing and picture
_OVER_DEEPEST = 0.05  # least depth of a dot relative to the deepest dots


@dataclass(frozen=True, eq=False)
class Dots:
    """Dots as ellipses.

    Attributes:
        centre: (n, 2) pixels from the outer corner of the top-left pixel.
        spread: (n, 2, 2) second central moments of the ellipses, pixels squared: a disc of radius r has r^2 / 4.
    """

    centre: FloatArray
    spread: FloatArray

    def __len__(self) -> int:
        return len(self.centre)

    def __getitem__(self, which: NDArray[np.generic]) -> "Dots":
        return Dots(self.centre[which], self.spread[which])

    @property
    def is_valid(self) -> NDArray[np.bool_]:
        """Mask (n,) of the dots that are not NaN."""
        return np.asarray(np.isfinite(self.centre).all(axis=-1) & np.isfinite(self.spread).all(axis=(-1, -2)))

    @property
    def radius(self) -> FloatArray:
        """Radii (n,) of the circles of equal area, pixels."""
        determinant = self.spread[:, 0, 0] * self.spread[:, 1, 1] - self.spread[:, 0, 1] ** 2
        return np.asarray(2.0 * determinant**0.25)


def find_dots(image: NDArray[np.generic]) -> Dots:
    """Detect all dark ellipses surrounded by lighter ground, to about half a pixel; clutter among them.

    Args:
        image: (h, w) grey, of any type.
    """
    level = image.astype(np.float32)
    levels, depths = [], []
    for octave in range(_LEVELS):
        if min(level.shape) < _KERNEL_PX:
            break
        dots, depth = _dots_of_level(level, _LEAST_AREA_BEYOND_PX if octave else LEAST_AREA_PX)
        # A pixel of the next level lies over every second pixel of this one, centre on centre.
        scale = 2.0**octave
        levels.append(Dots((dots.centre - 0.5) * scale + 0.5, dots.spread * scale**2))
        depths.append(depth)
        level = cv2.pyrDown(level)
    if not levels:
        return Dots(np.zeros((0, 2)), np.zeros((0, 2, 2)))
    dots = Dots(np.concatenate([each.centre for each in levels]), np.concatenate([each.spread for each in levels]))
    return dots[_deepest_of_each_place(dots, np.concatenate(depths))]


def _dots_of_level(level: FloatImage, least_area: float) -> tuple[Dots, FloatArray]:
    """Return the dots of up to the kernel's size, and the mean depth of each below the ground."""
    smooth = cv2.GaussianBlur(level, (3, 3), 0)
    square = np.ones((_KERNEL_PX, _KERNEL_PX), np.uint8)
    below = cv2.morphologyEx(smooth, cv2.MORPH_CLOSE, square) - smooth
    deepest_near = cv2.dilate(below, square)
    gate = max(_OVER_NOISE * float(np.median(below)), _OVER_DEEPEST * float(deepest_near.max()))
    dark = (below > 0.5 * deepest_near) & (deepest_near > gate)

    number, label, stats, _ = cv2.connectedComponentsWithStats(dark.astype(np.uint8), connectivity=4)
    left, top, width, height, area = stats.T
    inside = (left > 0) & (top > 0) & (left + width < level.shape[1]) & (top + height < level.shape[0])
    fitting = inside & (area >= least_area) & (np.maximum(width, height) <= _KERNEL_PX)

    v, u = np.nonzero(dark & fitting[label])
    return _as_ellipses(label[v, u], number, u, v, below[v, u])


def _as_ellipses(
    label: NDArray[np.int32], number: int, u: NDArray[np.int64], v: NDArray[np.int64], below: FloatImage
) -> tuple[Dots, FloatArray]:
    """Return the components as ellipses with their moments, without components that are not elliptic."""

    def total(of: NDArray[np.generic]) -> FloatArray:
        return np.asarray(np.bincount(label, of, number), dtype=np.float64)

    area = np.bincount(label, minlength=number).astype(np.float64)
    present = area > 0
    pixels = np.maximum(area, 1.0)
    centre = np.stack([total(u) / pixels, total(v) / pixels], axis=-1)
    du, dv = u - centre[label, 0], v - centre[label, 1]
    uu, uv, vv = total(du * du) / pixels, total(du * dv) / pixels, total(dv * dv) / pixels
    # A pixel is a square of one pixel, not a point.
    spread = np.stack([np.stack([uu + 1 / 12, uv], -1), np.stack([uv, vv + 1 / 12], -1)], -2)

    determinant, half_trace = np.linalg.det(spread), 0.5 * (spread[:, 0, 0] + spread[:, 1, 1])
    root = np.sqrt(np.maximum(half_trace**2 - determinant, 0.0))
    axes_ratio = np.sqrt((half_trace - root) / (half_trace + root))
    fullness = area / (4.0 * np.pi * np.sqrt(determinant))
    good = present & (axes_ratio >= _LEAST_AXES_RATIO) & (fullness >= _FULLNESS[0]) & (fullness <= _FULLNESS[1])
    return Dots(centre[good] + 0.5, spread[good]), (total(below) / pixels)[good]


def _deepest_of_each_place(dots: Dots, depth: FloatArray) -> NDArray[np.bool_]:
    """Return the mask (n,) of the deepest of dots that lie within one another, as levels and noise produce them."""
    keep = np.ones(len(dots), dtype=bool)
    if len(dots) < 2:
        return keep
    tree, radius = cKDTree(dots.centre), dots.radius
    within = tree.query_ball_point(dots.centre, radius)
    for dot in np.argsort(-depth):
        others = [other for other in within[dot] if other != dot] if keep[dot] else []
        keep[others] = False
    return keep
