"""Integer coordinates for dots of a square lattice that lens, perspective and optics distort.

A dot's ellipse shows the local foreshortening of the board, up to a rotation; with that undone its neighbours form a
right-angled cross. From a clear cross the lattice grows, each step predicted by the steps around it.
"""

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from wlr_render.captures.boards.dot_detection import Dots
from wlr_render.numerics.arrays import FloatArray, IntArray

_NEIGHBOURS = 16  # neighbours that include the four arms of the cross up to a foreshortening of 1 to 2
_SHAPE_NEIGHBOURS = 7
_CROSS_TOLERANCE = 0.3  # tolerance of the other three arms, in lengths of an arm
_STEP_TOLERANCE = 0.22  # largest distance of a dot from its prediction, in steps
_INHERITED = 1.0  # weight of the parent's steps relative to a neighbour's
LEAST_DOTS = 9
"""Fewest dots of a lattice."""

_MOST_SEEDS = 60  # most crosses from which a lattice is grown
_AROUND = np.array([(i, j) for i in range(-2, 3) for j in range(-2, 3) if (i, j) != (0, 0)])
_NEAR_FIRST = _AROUND[np.argsort(np.abs(_AROUND).max(axis=1) * 3 + np.abs(_AROUND).sum(axis=1), kind="stable")]


@dataclass(frozen=True, eq=False)
class DotLattice:
    """Dots that lie on one lattice.

    Attributes:
        dot: (k,) numbers of the dots.
        index: (k, 2) their integer coordinates; the second axis lies clockwise of the first, as v of u.
    """

    dot: IntArray
    index: IntArray

    def only(self, rows: NDArray[np.generic]) -> "DotLattice":
        """Return some of the dots, by mask (k,) or by position."""
        return DotLattice(self.dot[rows], self.index[rows])

    def __len__(self) -> int:
        return len(self.dot)


def link_lattices(dots: Dots) -> list[DotLattice]:
    """Return all lattices of 9 dots or more, the largest first; no dot is in two."""
    if len(dots) < LEAST_DOTS:
        return []
    tree = cKDTree(dots.centre)
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


def _crosses(dots: Dots, tree: cKDTree) -> tuple[IntArray, FloatArray]:
    """Return the dots with four neighbours in a cross, the clearest first, and their two steps (m, 2, 2), pixels."""
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
    # The shortest valid cross: a longer one would skip dots.
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


def _grown(centre: FloatArray, tree: cKDTree, seed: int, step: FloatArray, free: NDArray[np.bool_]) -> DotLattice:
    """Return the connected lattice of a seed; `step` is (2, 2), pixels per unit of each coordinate in rows."""
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
    """Return the least-squares step (2, 2) to known neighbours, regularised towards the inherited steps."""
    near = [(offset, other) for offset, other in neighbours if np.abs(offset).max() == 1]
    if not near:
        return inherited
    offsets = np.array([offset for offset, _ in near], dtype=np.float64)
    to_others = centre[[other for _, other in near]] - centre[dot]
    normal = offsets.T @ offsets + _INHERITED * np.eye(2)
    return np.linalg.solve(normal, offsets.T @ to_others + _INHERITED * inherited)
