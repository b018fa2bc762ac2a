"""Search for the sizes of motions and noise with the highest evidence, and for captures that moved."""

from dataclasses import replace

import numpy as np
import scipy

from wlr_render.numerics.arrays import FloatArray, IntArray
from wlr_render.numerics.scatter import (
    MOVED,
    PARTS,
    USUAL_SHIFT,
    USUAL_TURN,
    Scatter,
    ScatterSums,
    cost,
    cost_and_slopes,
    without_motions,
)

_RAISED = 3.0  # largest assumed size of ordinary motions, in usual sizes, when captures are tested for having moved
_STANDS_OUT = -10.0  # twice the gain in log likelihood by a wide motion from which a capture may have moved
_LOWEST, _HIGHEST = np.log(0.1), np.log(3000.0)
_NOISIEST = np.log(100.0)
_ENOUGH = 0.02  # fall of -2 log evidence in a step below which the search ends
FEWEST_TO_STAND_OUT = 4
"""Fewest captures of a part among which one can stand out."""


def best_scatter(sums: ScatterSums, start: Scatter) -> tuple[Scatter, float]:
    """Return the sizes of highest evidence, searched from a start with given moved captures, and -2 log evidence."""
    moving = np.array([bool(np.any(sums.ee[sums.part_of == part])) for part in range(PARTS)])
    present = sums.count > 0
    free = np.concatenate([present, moving, moving])
    first = start.vector()
    usual = np.repeat(np.log([1.0, USUAL_SHIFT, USUAL_TURN]), PARTS)
    first[~free] = usual[~free]

    def with_slopes(inner: FloatArray) -> tuple[float, FloatArray]:
        vector = first.copy()
        vector[free] = inner
        value, slopes = cost_and_slopes(sums, start.at(vector))
        return value, slopes.ravel()[free]

    low = np.concatenate([np.zeros(PARTS), np.full(2 * PARTS, _LOWEST)])[free]
    high = np.concatenate([np.full(PARTS, _NOISIEST), np.full(2 * PARTS, _HIGHEST)])[free]
    inside = np.clip(first[free], low, high)
    found = scipy.optimize.minimize(
        with_slopes,
        inside,
        jac=True,
        method="L-BFGS-B",
        bounds=np.stack([low, high], axis=1),
        options={"maxiter": 30, "ftol": _ENOUGH / max(abs(with_slopes(inside)[0]), 1.0), "gtol": 0.05},
    )
    vector = first.copy()
    vector[free] = found.x
    return start.at(vector), float(found.fun)


def with_moved_captures(sums: ScatterSums, start: Scatter) -> tuple[Scatter, float]:
    """Return the sizes of highest evidence, with captures that moved far more than others, and -2 log evidence.

    Captures of a part are added in the order of their gain by a wide motion, up to half of them; the number with the
    highest evidence is kept, and each moved capture is then tested alone.
    """
    best, least = best_scatter(sums, start.at_rest())
    if start.moved.any():
        best, least = min((best, least), best_scatter(sums, start), key=lambda each: each[1])
    for part in range(PARTS):
        own = np.flatnonzero(sums.used & (sums.part_of == part))
        if len(own) < FEWEST_TO_STAND_OUT or not np.any(sums.ee[own]):
            continue
        for _ in range(2):  # captures marked as moved in the first round no longer hide others
            gain = _own_gain(sums, best)[own]
            if np.max(gain) < _STANDS_OUT:
                break
            best, least = _prefix(sums, best, least, own[np.argsort(-gain)])
        best, least = one_by_one(sums, best, least, own[best.moved[own]])
    return best, least


def _prefix(sums: ScatterSums, best: Scatter, least: float, order: IntArray) -> tuple[Scatter, float]:
    """Return the scatter with the best number of moved captures, taken in the given order, and -2 log evidence."""
    most = len(order) // 2
    tried: dict[int, tuple[Scatter, float]] = {}

    def at(count: int) -> float:
        if count not in tried:
            moved = best.moved.copy()
            moved[order] = False
            moved[order[:count]] = True
            tried[count] = best_scatter(sums, replace(best, moved=moved))
        return tried[count][1]

    coarse = sorted({round(each) for each in np.geomspace(1, most, 8)})
    count = min(coarse, key=at)
    while (nearer := min((n for n in (count - 1, count + 1) if 1 <= n <= most), key=at, default=count)) != count:
        if at(nearer) >= at(count):
            break
        count = nearer
    return tried[count] if at(count) < least else (best, least)


def one_by_one(sums: ScatterSums, best: Scatter, least: float, captures: IntArray) -> tuple[Scatter, float]:
    """Invert the `moved` flag of each of some captures if that increases the evidence."""
    for number in captures:
        at = best.with_other(number)
        if cost(sums, at) < least:
            best, least = best_scatter(sums, at)
    return best, least


def scatter_errors(sums: ScatterSums, scatter: Scatter) -> FloatArray:
    """Return standard errors (3, parts) of the logarithms of noise, shifts and turns, from the evidence's curvature."""
    first, step = scatter.vector(), 0.1

    def at(vector: FloatArray) -> float:
        return cost(sums, scatter.at(vector))

    at_best = at(first)
    curvature = np.array([(at(first + step * u) - 2 * at_best + at(first - step * u)) / step**2 for u in np.eye(9)])
    return np.asarray(np.sqrt(2.0 / curvature.clip(1e-3)).reshape(3, PARTS))


def _own_gain(sums: ScatterSums, scatter: Scatter) -> FloatArray:
    """Return twice the gain in log likelihood by a wide motion of each capture (g,)."""
    pull = _pull(sums, scatter)
    noise = scatter.noise[sums.part_of][:, None]
    # Limit the sizes: several moved captures raise the size found for all, which would hide them.
    shift, turn = (
        np.minimum(size, _RAISED * usual)
        for size, usual in ((scatter.shift_um, USUAL_SHIFT), (scatter.turn_urad, USUAL_TURN))
    )
    at_rest = replace(scatter.at_rest(), shift_um=shift, turn_urad=turn)
    usual = at_rest.sizes(sums.part_of)
    wide = np.hypot(usual, MOVED / noise)

    def likelihood(sizes: FloatArray) -> FloatArray:
        normal = sizes[:, :, None] * sums.ee * sizes[:, None, :] + np.eye(6)
        side = sizes * pull / noise
        _, determinant = np.linalg.slogdet(normal)
        return np.asarray(np.einsum("gi,gi->g", side, np.linalg.solve(normal, side[:, :, None])[:, :, 0]) - determinant)

    return likelihood(wide) - likelihood(usual)


def _pull(sums: ScatterSums, scatter: Scatter) -> FloatArray:
    """Return the sums (g, 6) of motions and readings, minus the most probable effect of all columns."""
    return np.asarray(sums.ey - sums.ex @ without_motions(sums, scatter).values)


def motions_of(sums: ScatterSums, scatter: Scatter) -> FloatArray:
    """Return the most probable motion (g, 6) of each capture, micrometres and microradians, at the fitted values."""
    sizes = scatter.sizes(sums.part_of)
    normal = sizes[:, :, None] * sums.ee * sizes[:, None, :] + np.eye(6)
    pull = _pull(sums.of_columns(np.zeros(0, dtype=np.int64)), scatter)
    return np.asarray(sizes * np.linalg.solve(normal, (sizes * pull)[:, :, None])[:, :, 0])
