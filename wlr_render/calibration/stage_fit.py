"""Fit a straight stage to photographs of a board that does not move, and find single faults among them.

On an ideal stage the camera keeps its orientation, so that with the stage displaced by `d = reading - reference` the
board is seen at `camera_from_target(reading) = translation(-axes @ d) @ camera_from_target(reference)`. A real stage
departs from that in position and orientation; both departures are estimated as well. All photographs are fitted
together by generalised least squares, since lens errors correlate them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from wlr_render.calibration.board_poses import BoardPoses
from wlr_render.calibration.poses import Pose, motion_between
from wlr_render.calibration.stage_problem import (
    STILL,
    Jitter,
    StageProblem,
    StageSolution,
    fit_with_jitter,
    solve_stage,
)
from wlr_render.errors import BadInputError
from wlr_render.geometry.directions import ARCMIN
from wlr_render.numerics.arrays import FloatArray, IntArray

_MIN_F_RATIO = 20.0  # ratio of F that makes one photograph an outlier: beyond 1e-8 by chance
_CHI_SQUARE = 2.0  # per degree of freedom; a fit that is no worse has no faults worth a search
_EXPLAINS = 0.1  # a target that moved is believed if it leaves no more than this part of the sum of squares
_NOTICED_M = 3e-5  # an outlier must be this far off, or
_NOTICED_RAD = 0.3 * ARCMIN  # turned by this much: below both, it does no harm


def outlier(problem: StageProblem) -> tuple[int, FloatArray] | None:
    """Return the index of the single outlying photograph and its deviation (6,) from the fit to the others, if any."""
    whole = solve_stage(problem).chi_square
    best: tuple[float, int, StageSolution] | None = None
    if whole < _CHI_SQUARE * problem.freedom:
        return None
    for row in range(len(problem.seen)):
        rest = problem.without(row)
        if not rest.determined or rest.freedom <= 6:
            continue
        solution = solve_stage(rest)
        ratio = (whole - solution.chi_square) / 6 / (solution.chi_square / rest.freedom)
        if best is None or ratio > best[0]:
            best = ratio, row, solution
    if best is None or best[0] < _MIN_F_RATIO:
        return None
    _, row, solution = best
    deviation = motion_between(problem.predicted(solution.axes, solution.poses)[row], problem.seen[row])
    noticed = np.linalg.norm(deviation[3:]) > _NOTICED_M or np.linalg.norm(deviation[:3]) > _NOTICED_RAD
    return (row, deviation) if noticed else None


def target_step(problem: StageProblem) -> tuple[int, int, FloatArray] | None:
    """Return where in the order of photographs the target moved, if that explains the residuals.

    Returns:
        The last photograph before and the first after, by index, and the target's small motion (6,) in the camera's
        frame at the reference.
    """
    whole = solve_stage(problem).chi_square
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
            solution = solve_stage(split)
            if solution.chi_square < best:
                motion = motion_between(solution.poses[target], solution.poses[extra])
                best, found = solution.chi_square, (int(before), int(row), motion)
    return found


@dataclass(frozen=True, eq=False)
class TargetMoved:
    """A motion (6,) of the target, camera frame, between the photographs named `before` and `after`."""

    before: str
    after: str
    motion: FloatArray


@dataclass(frozen=True, eq=False)
class StageFit:
    """A fitted straight stage, with the repeatability of its camera.

    Attributes:
        reference: (3,) the reading that poses are given at, the middle of all readings.
        travel: the largest range of the readings of an axis.
        moved_axes: (m,) indices of the axes whose readings changed.
        axes: (3, m) camera frame: true displacement per reading of each moved axis, metres per metre.
        camera_from_target: target pose number -> (4, 4) at the reference.
        covariance: (3 m + 6 k, 3 m + 6 k) of the axes, one after the other, and of small motions of the k poses in the
            camera's frame.
        jitter: repeatability of the camera about the straight motion, beyond the noise of the dots; it is in the
            covariance.
        names: n photographs that were fitted.
        residual: (n, 6) small motion in the camera's frame from the fitted pose to the one seen.
        rejected: photograph -> (6,) deviation from the fit to the others.
        target_moved: where the target was moved meanwhile, if that is why the photographs do not fit.
    """

    reference: FloatArray
    travel: float
    moved_axes: IntArray
    axes: FloatArray
    camera_from_target: dict[int, FloatArray]
    covariance: FloatArray
    jitter: Jitter
    names: tuple[str, ...]
    residual: FloatArray
    rejected: dict[str, FloatArray] = field(default_factory=dict)
    target_moved: TargetMoved | None = None

    def displacement(self, reading: FloatArray) -> FloatArray:
        """(..., 3) readings -> (..., 3) metres from the reference, camera frame.

        Raises:
            BadInputError: a reading of an axis that no photograph without the headset moved.
        """
        offset = np.asarray(reading, dtype=np.float64) - self.reference
        held = np.setdiff1d(np.arange(3), self.moved_axes)
        off = np.abs(offset).reshape(-1, 3).max(axis=0)[held]
        if np.any(off > STILL * self.travel):
            axis = "xyz"[held[np.argmax(off)]]
            raise BadInputError(
                f"stage readings vary along axis {axis}, but no photograph without the headset does; take some that do."
            )
        return np.asarray(offset[..., self.moved_axes] @ self.axes.T)

    @property
    def out_of_plane_m(self) -> float:
        """Rms distance of the camera from the plane of two axes; NaN unless two moved."""
        if len(self.moved_axes) != 2:
            return np.nan
        normal = np.cross(self.axes[:, 0], self.axes[:, 1])
        return float(np.sqrt(np.mean((self.residual[:, 3:] @ normal / np.linalg.norm(normal)) ** 2)))

    def pose(self, target: int) -> Pose:
        """camera_from_target at the reference."""
        start = 3 * len(self.moved_axes) + 6 * list(self.camera_from_target).index(target)
        rows = slice(start, start + 6)
        return Pose(self.camera_from_target[target], self.covariance[rows, rows])


def fit_stage(seen: BoardPoses, target: Sequence[int], reading: FloatArray) -> StageFit:
    """Fit straight axes to photographs of a board taken without the headset.

    Args:
        seen: n photographs and the poses of the board in them.
        target: n, the number of the target pose that each shows.
        reading: (n, 3) stage readings, metres.

    Raises:
        BadInputError: too few photographs, or axes that were only moved together.
    """
    reading = np.asarray(reading, dtype=np.float64)
    moved_axes = _moved_axes(reading)
    reference = 0.5 * (reading.min(axis=0) + reading.max(axis=0))
    numbers, index = np.unique(np.asarray(target, dtype=np.int64), return_inverse=True)
    problem = StageProblem(seen.camera_from_board, seen.covariance, index, (reading - reference)[:, moved_axes])
    if not problem.determined or problem.freedom <= 0:
        raise BadInputError(
            f"{len(seen)} photographs without the headset do not determine how the stage moves along "
            f"{' and '.join('xyz'[axis] for axis in moved_axes)}; take a grid of 5 or more at one pose of the target."
        )
    names = list(seen.names)
    rejected = {}
    while (found := outlier(problem)) is not None:
        row, deviation = found
        rejected[names.pop(row)] = deviation
        problem = problem.without(row)
    step = target_step(problem)
    jitter, solution = fit_with_jitter(problem)
    return StageFit(
        reference,
        float(np.ptp(reading, axis=0).max()),
        moved_axes,
        solution.axes,
        dict(zip(numbers.tolist(), solution.poses, strict=True)),
        solution.covariance,
        jitter,
        tuple(names),
        solution.residual,
        rejected,
        TargetMoved(names[step[0]], names[step[1]], step[2]) if step else None,
    )


def _moved_axes(reading: FloatArray) -> IntArray:
    if len(reading) == 0:
        raise BadInputError("no photograph without the headset shows the target; the stage axes cannot be fitted.")
    travel = np.ptp(reading, axis=0)
    if not travel.max() > 0:
        raise BadInputError(
            "all photographs without the headset have the same stage reading; take some at other readings, "
            "so that the stage's axes can be found."
        )
    return np.flatnonzero(travel > STILL * travel.max())
