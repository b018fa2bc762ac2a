"""Dark dots on a lighter background in unevenly lit photographs, and the distorted square lattices that they form.

A morphological closing estimates the ground under the dots; a dot is a region darker than the ground. Each level of a
pyramid detects dots up to twice the size of the previous level. The ellipse of a dot shows the local foreshortening of
the board, up to a rotation; once this is undone, the dot's neighbours form a right-angled cross. The lattice grows from
a clear cross, and each step is predicted from the steps around it.
"""

from collections import deque
from dataclasses import dataclass

import cv2
import numpy as np
import scipy
from numpy.typing import NDArray

from wlr_render.numerics.arrays import FloatArray, IntArray

FloatImage = NDArray[np.float32]

_LEVELS = 5  # pyramid levels: dots of up to 24 px on the finest, 380 px on the coarsest
_KERNEL_PX = 25  # side of the closing's square, on each level
LEAST_AREA_PX = 8.0
"""Least area of a dot on the finest level."""
_LEAST_AREA_BEYOND_PX = 60.0  # least area on coarser levels; the previous level detects smaller dots better
_FULLNESS = (0.8, 1.15)  # range of the area relative to the ellipse with equal second moments
_LEAST_AXES_RATIO = 0.3  # least ratio of a dot's axes, for a board tilted by 70 degrees
_OVER_NOISE = 4.0  # least depth of a dot, in median differences of closing and picture
_OVER_DEEPEST = 0.05  # least depth of a dot relative to the deepest dots
_NEIGHBOURS = 16  # neighbours searched for the four arms of the cross; enough for a foreshortening of 1 to 2
_SHAPE_NEIGHBOURS = 7
_CROSS_TOLERANCE = 0.3  # tolerance of the other three arms, in lengths of an arm
_STEP_TOLERANCE = 0.22  # largest distance of a dot from its prediction, in steps
_INHERITED = 1.0  # weight of the inherited steps relative to a neighbour's
LEAST_DOTS = 9
"""Fewest dots of a lattice."""

_MOST_SEEDS = 60  # most crosses from which lattices are grown
_AROUND = np.array([(i, j) for i in range(-2, 3) for j in range(-2, 3) if (i, j) != (0, 0)])
_NEAR_FIRST = _AROUND[np.argsort(np.abs(_AROUND).max(axis=1) * 3 + np.abs(_AROUND).sum(axis=1), kind="stable")]


@dataclass(frozen=True, eq=False)
class Dots:
    """Dots as ellipses.

    Attributes:
        centre: (n, 2) centres, pixels from the outer corner of the top-left pixel.
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
    """Detect all dark ellipses on lighter ground, including clutter, to about half a pixel.

    Args:
        image: (h, w) grey, of any type.
    """
    level = image.astype(np.float32)
    levels, depths = [], []
    for octave in range(_LEVELS):
        if min(level.shape) < _KERNEL_PX:
            break
        dots, depth = _dots_of_level(level, _LEAST_AREA_BEYOND_PX if octave else LEAST_AREA_PX)
        # Pixels of the next level are centred on every second pixel of this level.
        scale = 2.0**octave
        levels.append(Dots((dots.centre - 0.5) * scale + 0.5, dots.spread * scale**2))
        depths.append(depth)
        level = cv2.pyrDown(level)
    if not levels:
        return Dots(np.zeros((0, 2)), np.zeros((0, 2, 2)))
    dots = Dots(np.concatenate([each.centre for each in levels]), np.concatenate([each.spread for each in levels]))
    return dots[_deepest_of_each_place(dots, np.concatenate(depths))]


def _dots_of_level(level: FloatImage, least_area: float) -> tuple[Dots, FloatArray]:
    """Return the dots up to the kernel's size, and the mean depth of each below the ground."""
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
    """Return the elliptic components as ellipses with the same moments, and their mean depths."""

    def total(of: NDArray[np.generic]) -> FloatArray:
        return np.asarray(np.bincount(label, of, number), dtype=np.float64)

    area = np.bincount(label, minlength=number).astype(np.float64)
    present = area > 0
    pixels = np.maximum(area, 1.0)
    centre = np.stack([total(u) / pixels, total(v) / pixels], axis=-1)
    du, dv = u - centre[label, 0], v - centre[label, 1]
    uu, uv, vv = total(du * du) / pixels, total(du * dv) / pixels, total(dv * dv) / pixels
    # A pixel is a unit square, not a point.
    spread = np.stack([np.stack([uu + 1 / 12, uv], -1), np.stack([uv, vv + 1 / 12], -1)], -2)

    determinant, half_trace = np.linalg.det(spread), 0.5 * (spread[:, 0, 0] + spread[:, 1, 1])
    root = np.sqrt(np.maximum(half_trace**2 - determinant, 0.0))
    axes_ratio = np.sqrt((half_trace - root) / (half_trace + root))
    fullness = area / (4.0 * np.pi * np.sqrt(determinant))
    good = present & (axes_ratio >= _LEAST_AXES_RATIO) & (fullness >= _FULLNESS[0]) & (fullness <= _FULLNESS[1])
    return Dots(centre[good] + 0.5, spread[good]), (total(below) / pixels)[good]


def _deepest_of_each_place(dots: Dots, depth: FloatArray) -> NDArray[np.bool_]:
    """Return the mask (n,) of the deepest among dots within one another, which levels and noise produce."""
    keep = np.ones(len(dots), dtype=bool)
    if len(dots) < 2:
        return keep
    tree, radius = scipy.spatial.cKDTree(dots.centre), dots.radius
    within = tree.query_ball_point(dots.centre, radius)
    for dot in np.argsort(-depth):
        others = [other for other in within[dot] if other != dot] if keep[dot] else []
        keep[others] = False
    return keep


@dataclass(frozen=True, eq=False)
class DotLattice:
    """Dots that lie on one lattice.

    Attributes:
        dot: (k,) numbers of the dots.
        index: (k, 2) integer coordinates of the dots; the second axis is clockwise of the first, as v is of u.
    """

    dot: IntArray
    index: IntArray

    def only(self, rows: NDArray[np.generic]) -> "DotLattice":
        """Return the dots selected by a mask (k,) or by positions."""
        return DotLattice(self.dot[rows], self.index[rows])

    def __len__(self) -> int:
        return len(self.dot)


def link_lattices(dots: Dots) -> list[DotLattice]:
    """Return all lattices of 9 dots or more, the largest first; no dot is in two."""
    if len(dots) < LEAST_DOTS:
        return []
    tree = scipy.spatial.cKDTree(dots.centre)
    seeds, steps = _crosses(dots, tree)
    free = np.ones(len(dots), dtype=bool)
    lattices: list[DotLattice] = []
    for seed, step in zip(seeds, steps, strict=True):
        if len(lattices) >= _MOST_SEEDS:
            break
        if not free[seed]:
            continue
        lattice = _grown(dots.centre, tree, int(seed), step, free)
        free[lattice.dot] = False
        lattices.append(lattice)
    return sorted((each for each in lattices if len(each) >= LEAST_DOTS), key=len, reverse=True)


def _crosses(dots: Dots, tree: "scipy.spatial.cKDTree") -> tuple[IntArray, FloatArray]:
    """Return the dots with four neighbours in a cross, clearest first, and the cross's two steps (m, 2, 2), pixels."""
    count = min(_NEIGHBOURS + 1, len(dots))
    near = tree.query(dots.centre, count)[1][:, 1:]
    to_near = dots.centre[near] - dots.centre[:, None, :]
    straightened = np.einsum("nkl,nml->nmk", _straightening(dots, near), to_near)

    length = np.linalg.norm(straightened, axis=-1)
    arm = np.take_along_axis(straightened, np.argsort(length, axis=1)[:, :4, None], axis=1)
    quarter = np.stack([-arm[..., 1], arm[..., 0]], axis=-1)
    others = np.stack([arm, quarter, -arm, -quarter], axis=2)  # (n, arm, direction in the cross, 2)
    away = np.linalg.norm(others[:, :, :, None, :] - straightened[:, None, None, :, :], axis=-1)
    off = away.min(axis=-1).max(axis=-1) / np.maximum(np.linalg.norm(arm, axis=-1), 1e-9)
    # Take the shortest valid cross, because a longer one would skip dots.
    first = np.argmax(off < _CROSS_TOLERANCE, axis=1)
    every = np.arange(len(dots))
    error = off[every, first]
    which = away[every, first].argmin(axis=-1)[:, :2]
    steps = to_near[every[:, None], which]
    seeds = np.argsort(error, kind="stable")
    seeds = seeds[error[seeds] < _CROSS_TOLERANCE]
    return seeds, steps[seeds]


def _straightening(dots: Dots, near: IntArray) -> FloatArray:
    """Return (n, 2, 2) maps of unit determinant that make the ellipses near a dot round again."""
    flat = dots.spread / np.sqrt(np.linalg.det(dots.spread))[:, None, None]
    usual = np.median(np.concatenate([flat[:, None], flat[near[:, : _SHAPE_NEIGHBOURS - 1]]], axis=1), axis=1)
    squares, axes = np.linalg.eigh(usual)
    return np.asarray(np.einsum("nik,nk,njk->nij", axes, np.maximum(squares, 1e-9) ** -0.5, axes))


def _grown(
    centre: FloatArray, tree: "scipy.spatial.cKDTree", seed: int, step: FloatArray, free: NDArray[np.bool_]
) -> DotLattice:
    """Return the lattice connected to a seed; row i of `step` (2, 2) is pixels per unit of coordinate i."""
    at = {(0, 0): seed}
    index_of = {seed: (0, 0)}
    steps_of = {seed: step}
    waiting = deque([seed])
    while waiting:
        dot = waiting.popleft()
        centre_index = np.array(index_of[dot])
        around = [
            (offset, at.get((centre_index[0] + offset[0], centre_index[1] + offset[1]))) for offset in _NEAR_FIRST
        ]
        linked = [(offset, other) for offset, other in around if other is not None]
        steps_of[dot] = _local_step(centre, dot, linked, steps_of[dot])
        open_offsets = np.array([offset for offset, other in around if other is None])
        if not len(open_offsets):
            continue
        reach = _STEP_TOLERANCE * min(np.linalg.norm(steps_of[dot], axis=1))
        away, nearest = tree.query(centre[dot] + open_offsets @ steps_of[dot], distance_upper_bound=reach)
        for offset, other in zip(open_offsets[np.isfinite(away)], nearest[np.isfinite(away)], strict=True):
            place = (int(centre_index[0] + offset[0]), int(centre_index[1] + offset[1]))
            if other in index_of or place in at or not free[other]:
                continue
            at[place], index_of[int(other)], steps_of[int(other)] = int(other), place, steps_of[dot]
            waiting.append(int(other))
    return DotLattice(np.array(list(index_of)), np.array(list(index_of.values())))


def _local_step(
    centre: FloatArray, dot: int, neighbours: list[tuple[IntArray, int]], inherited: FloatArray
) -> FloatArray:
    """Return the least-squares steps (2, 2) to known neighbours, regularised towards the inherited steps."""
    near = [(offset, other) for offset, other in neighbours if np.abs(offset).max() == 1]
    if not near:
        return inherited
    offsets = np.array([offset for offset, _ in near], dtype=np.float64)
    to_others = centre[[other for _, other in near]] - centre[dot]
    normal = offsets.T @ offsets + _INHERITED * np.eye(2)
    return np.linalg.solve(normal, offsets.T @ to_others + _INHERITED * inherited)
