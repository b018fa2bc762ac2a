"""How the stage carries the camera, from photographs of a board that stands still.

The camera keeps its orientation, so that with the stage displaced by `d = reading - reference` the board is seen at
`camera_from_target(reading) = translation(-axes @ d) @ camera_from_target(reference)`. All photographs are fitted
together by generalised least squares, as their errors share those of the lens.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from wlr_render.calibration.board_views import BoardPoses
from wlr_render.calibration.poses import ARCMIN, Pose, adjoint, motion_between, small_motion
from wlr_render.errors import BadInputError
from wlr_render.geometry import transforms

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

_STEPS = 4  # of Gauss and Newton; the problem is nearly linear
_STILL = 1e-3  # an axis whose readings vary by less than this part of the largest travel has not moved
_SUSPECT = 20.0  # ratio of F that makes one photograph an outsider: beyond 1e-8 by chance
_NOTICED_M = 3e-5  # an outsider must be this far off, or
_NOTICED_RAD = 0.3 * ARCMIN  # turned by this much: below both, it does no harm


@dataclass(frozen=True, eq=False)
class StageFit:
    """A straight stage.

    Attributes:
        reference: (3,) the reading that poses are given at, the middle of all readings.
        moved: (m,) indices of the axes whose readings changed.
        axes: (3, m) camera frame: true displacement per reading of each moved axis, metres per metre.
        camera_from_target: target pose number -> (4, 4) at the reference.
        covariance: (3 m + 6 k, 3 m + 6 k) of the axes, one after the other, and of small motions of the k poses in the
            camera's frame.
        jitter_m: rms by which the camera strays from the straight motion beyond the noise of the dots, per direction;
            it is in the covariance.
        names: n photographs that were fitted.
        residual: (n, 6) small motion in the camera's frame from the fitted pose to the one seen.
        set_aside: photograph -> (6,) by how much it does not fit the others.
    """

    reference: FloatArray
    moved: IntArray
    axes: FloatArray
    camera_from_target: dict[int, FloatArray]
    covariance: FloatArray
    jitter_m: float
    names: tuple[str, ...]
    residual: FloatArray
    set_aside: dict[str, FloatArray] = field(default_factory=dict)

    def displacement(self, reading: FloatArray) -> FloatArray:
        """(..., 3) readings -> (..., 3) metres from the reference, camera frame.

        Raises:
            BadInputError: a reading of an axis that no photograph without the headset moved.
        """
        apart = np.asarray(reading, dtype=np.float64) - self.reference
        held = np.setdiff1d(np.arange(3), self.moved)
        travel = np.abs(apart).max(initial=0.0)
        if np.any(np.abs(apart[..., held]) > _STILL * travel):
            axis = "xyz"[held[np.argmax(np.abs(apart[..., held]).reshape(-1, len(held)).max(axis=0))]]
            raise BadInputError(
                f"stage readings move axis {axis}, along which no photograph without the headset was taken; take some."
            )
        return np.asarray(apart[..., self.moved] @ self.axes.T)

    @property
    def out_of_plane_m(self) -> float:
        """Rms distance of the camera from the plane of two axes; NaN unless two moved."""
        if len(self.moved) != 2:
            return np.nan
        normal = np.cross(self.axes[:, 0], self.axes[:, 1])
        return float(np.sqrt(np.mean((self.residual[:, 3:] @ normal / np.linalg.norm(normal)) ** 2)))

    def pose(self, target: int) -> Pose:
        """camera_from_target at the reference."""
        start = 3 * len(self.moved) + 6 * list(self.camera_from_target).index(target)
        rows = slice(start, start + 6)
        return Pose(self.camera_from_target[target], self.covariance[rows, rows])


@dataclass(frozen=True, eq=False)
class _Problem:
    """Photographs of `target` (n,), an index into the target poses, at displacements (n, m) from the reference."""

    seen: FloatArray
    covariance: FloatArray
    target: IntArray
    displacement: FloatArray

    def without(self, row: int) -> "_Problem":
        keep = np.delete(np.arange(len(self.seen)), row)
        rows = (6 * keep[:, None] + np.arange(6)).ravel()
        return _Problem(
            self.seen[keep], self.covariance[np.ix_(rows, rows)], self.target[keep], self.displacement[keep]
        )

    @property
    def determined(self) -> bool:
        """Whether every axis is moved by photographs of one target pose, and every target pose seen."""
        design = np.concatenate([np.eye(self.target.max() + 1)[self.target], self.displacement], axis=1)
        scale = np.linalg.norm(design, axis=0)
        return bool(np.all(scale > 0) and np.linalg.matrix_rank(design / scale, tol=_STILL) == design.shape[1])

    @property
    def freedom(self) -> int:
        """Readings less unknowns."""
        return 6 * len(self.seen) - 3 * self.displacement.shape[1] - 6 * int(self.target.max() + 1)

    def predicted(self, axes: FloatArray, poses: FloatArray) -> FloatArray:
        """(n, 4, 4) camera_from_target."""
        return transforms.rigid(np.eye(3), -self.displacement @ axes.T) @ poses[self.target]


@dataclass(frozen=True, eq=False)
class _Solution:
    axes: FloatArray
    poses: FloatArray
    covariance: FloatArray
    residual: FloatArray
    chi_square: float


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
    moved = _moved(reading)
    reference = 0.5 * (reading.min(axis=0) + reading.max(axis=0))
    numbers, index = np.unique(np.asarray(target, dtype=np.int64), return_inverse=True)
    problem = _Problem(seen.camera_from_board, seen.covariance, index, (reading - reference)[:, moved])
    if not problem.determined or problem.freedom <= 0:
        raise BadInputError(
            f"{len(seen)} photographs without the headset do not tell how the stage moves along "
            f"{' and '.join('xyz'[axis] for axis in moved)}; take a grid of 5 or more at one pose of the target."
        )
    names = list(seen.names)
    set_aside = {}
    while (outsider := _outsider(problem)) is not None:
        row, by = outsider
        set_aside[names.pop(row)] = by
        problem = problem.without(row)
    jitter_m, solution = _with_jitter(problem)
    return StageFit(
        reference,
        moved,
        solution.axes,
        dict(zip(numbers.tolist(), solution.poses, strict=True)),
        solution.covariance,
        jitter_m,
        tuple(names),
        solution.residual,
        set_aside,
    )


def _moved(reading: FloatArray) -> IntArray:
    if len(reading) == 0:
        raise BadInputError("no photograph without the headset shows the target; the stage cannot be found.")
    travel = np.ptp(reading, axis=0)
    if not travel.max() > 0:
        raise BadInputError(
            "all photographs without the headset have the same stage reading; take some at other readings, "
            "so that the stage's axes can be found."
        )
    return np.flatnonzero(travel > _STILL * travel.max())


def _solved(problem: _Problem, jitter_m: float = 0.0) -> _Solution:
    count, axis_count = problem.displacement.shape
    covariance = problem.covariance + jitter_m**2 * np.diag(np.tile([0.0, 0, 0, 1, 1, 1], count))
    inverse_root = np.linalg.inv(np.linalg.cholesky(covariance))
    axes, poses = _start(problem)
    for _ in range(_STEPS):
        residual = motion_between(problem.predicted(axes, poses), problem.seen)
        design = inverse_root @ _design(problem, axes)
        normal = np.linalg.inv(design.T @ design)
        step = normal @ design.T @ (inverse_root @ residual.ravel())
        axes = axes + step[: 3 * axis_count].reshape(axis_count, 3).T
        poses = small_motion(step[3 * axis_count :].reshape(-1, 6)) @ poses
    residual = motion_between(problem.predicted(axes, poses), problem.seen)
    return _Solution(axes, poses, np.asarray(normal), residual, float(np.sum((inverse_root @ residual.ravel()) ** 2)))


def _start(problem: _Problem) -> tuple[FloatArray, FloatArray]:
    """Axes from positions alone, and each target pose from the first photograph of it."""
    count = problem.target.max() + 1
    design = np.concatenate([np.eye(count)[problem.target], -problem.displacement], axis=1)
    found = np.linalg.lstsq(design, problem.seen[:, :3, 3], rcond=None)[0]
    first = [int(np.argmax(problem.target == k)) for k in range(count)]
    return found[count:].T, transforms.rigid(problem.seen[first, :3, :3], found[:count])


def _design(problem: _Problem, axes: FloatArray) -> FloatArray:
    """(6 n, unknowns): small motions of the predicted poses by axes and target poses."""
    count, axis_count = problem.displacement.shape
    design = np.zeros((count, 6, 3 * axis_count + 6 * int(problem.target.max() + 1)))
    for axis in range(axis_count):
        design[:, 3:, 3 * axis : 3 * axis + 3] = -problem.displacement[:, axis, None, None] * np.eye(3)
    moved_frame = adjoint(transforms.rigid(np.eye(3), -problem.displacement @ axes.T))
    for row, k in enumerate(problem.target):
        start = 3 * axis_count + 6 * k
        design[row, :, start : start + 6] = moved_frame[row]
    return design.reshape(6 * count, -1)


def _outsider(problem: _Problem) -> tuple[int, FloatArray] | None:
    """The one photograph that spoils the fit, and by how much (6,) it differs from what the others say of it."""
    whole = _solved(problem).chi_square
    best: tuple[float, int, _Solution] | None = None
    if whole < 2 * problem.freedom:
        return None
    for row in range(len(problem.seen)):
        rest = problem.without(row)
        if not rest.determined or rest.freedom <= 6:
            continue
        solution = _solved(rest)
        ratio = (whole - solution.chi_square) / 6 / (solution.chi_square / rest.freedom)
        if best is None or ratio > best[0]:
            best = ratio, row, solution
    if best is None or best[0] < _SUSPECT:
        return None
    _, row, solution = best
    by = motion_between(problem.predicted(solution.axes, solution.poses)[row], problem.seen[row])
    noticed = np.linalg.norm(by[3:]) > _NOTICED_M or np.linalg.norm(by[:3]) > _NOTICED_RAD
    return (row, by) if noticed else None


def _with_jitter(problem: _Problem) -> tuple[float, _Solution]:
    """The solution whose residuals are as large as expected, by the camera straying as much as that takes."""
    solution = _solved(problem)
    if solution.chi_square <= problem.freedom:
        return 0.0, solution
    low, high = 1e-9, 1.0
    for _ in range(30):
        middle = float(np.sqrt(low * high))
        too_little = _solved(problem, middle).chi_square > problem.freedom
        low, high = (middle, high) if too_little else (low, middle)
    return high, _solved(problem, high)
