"""Single faults that spoil a stage fit: one photograph that moved, or a target that was moved between two."""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from wlr_render.calibration.poses import ARCMIN, motion_between
from wlr_render.calibration.stage_problem import StageProblem, StageSolution, solved
from wlr_render.numerics.arrays import FloatArray

_SUSPECT = 20.0  # ratio of F that makes one photograph an outsider: beyond 1e-8 by chance
_CHI_SQUARE = 2.0  # per degree of freedom; a fit that is no worse has no faults worth a search
_EXPLAINS = 0.1  # a target that moved is believed if it leaves no more than this part of the sum of squares
_NOTICED_M = 3e-5  # an outsider must be this far off, or
_NOTICED_RAD = 0.3 * ARCMIN  # turned by this much: below both, it does no harm


def outsider(problem: StageProblem) -> tuple[int, FloatArray] | None:
    """The one photograph that spoils the fit, and by how much (6,) it differs from what the others say of it."""
    whole = solved(problem).chi_square
    best: tuple[float, int, StageSolution] | None = None
    if whole < _CHI_SQUARE * problem.freedom:
        return None
    for row in range(len(problem.seen)):
        rest = problem.without(row)
        if not rest.determined or rest.freedom <= 6:
            continue
        solution = solved(rest)
        ratio = (whole - solution.chi_square) / 6 / (solution.chi_square / rest.freedom)
        if best is None or ratio > best[0]:
            best = ratio, row, solution
    if best is None or best[0] < _SUSPECT:
        return None
    _, row, solution = best
    by = motion_between(problem.predicted(solution.axes, solution.poses)[row], problem.seen[row])
    noticed = np.linalg.norm(by[3:]) > _NOTICED_M or np.linalg.norm(by[:3]) > _NOTICED_RAD
    return (row, by) if noticed else None


@dataclass(frozen=True, eq=False)
class TargetStep:
    """A target that was moved while photographs of it were taken.

    Attributes:
        row: the first photograph after.
        before: the last one before.
        motion: (6,) small motion of the target in the camera's frame at the reference.
    """

    row: int
    before: int
    motion: FloatArray


def target_step(problem: StageProblem) -> TargetStep | None:
    """The place in the order of photographs where a target moved, if that explains why they do not fit."""
    whole = solved(problem).chi_square
    if whole < _CHI_SQUARE * problem.freedom:
        return None
    best, found = _EXPLAINS * whole, None
    extra = int(problem.target.max() + 1)
    for target in range(extra):
        rows = np.flatnonzero(problem.target == target)
        for before, row in pairwise(rows[1:-1]):
            later = (problem.target == target) & (np.arange(len(problem.target)) >= row)
            split = replace(problem, target=np.where(later, extra, problem.target))
            if not split.determined or split.freedom <= 0:
                continue
            solution = solved(split)
            if solution.chi_square < best:
                motion = motion_between(solution.poses[target], solution.poses[extra])
                best, found = solution.chi_square, TargetStep(int(row), int(before), motion)
    return found
