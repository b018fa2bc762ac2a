"""Generalised least squares for a straight stage, from poses whose errors depend on each other."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wlr_render.calibration.poses import adjoint, beyond_chance, motion_between, small_motion
from wlr_render.geometry import transforms

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

STILL = 1e-3
"""An axis whose readings vary by less than this part of the largest travel has not moved."""

_HALVINGS = 16  # of 18 e-foldings of jitter: to 3 parts in 10,000
_STEPS = 4  # of Gauss and Newton; the problem is nearly linear


@dataclass(frozen=True, eq=False)
class StageProblem:
    """Poses at stage readings.

    Attributes:
        seen: (n, 4, 4) camera_from_target.
        covariance: (6 n, 6 n) of small motions in the camera's frame.
        target: (n,) index of the target pose.
        displacement: (n, m) readings of the axes that moved, less the reference.
    """

    seen: FloatArray
    covariance: FloatArray
    target: IntArray
    displacement: FloatArray

    def without(self, row: int) -> "StageProblem":
        """All but one photograph."""
        keep = np.delete(np.arange(len(self.seen)), row)
        rows = (6 * keep[:, None] + np.arange(6)).ravel()
        return StageProblem(
            self.seen[keep], self.covariance[np.ix_(rows, rows)], self.target[keep], self.displacement[keep]
        )

    @property
    def determined(self) -> bool:
        """Whether every axis is moved by photographs of one target pose, and every target pose seen."""
        design = np.concatenate([np.eye(self.target.max() + 1)[self.target], self.displacement], axis=1)
        scale = np.linalg.norm(design, axis=0)
        return bool(np.all(scale > 0) and np.linalg.matrix_rank(design / scale, tol=STILL) == design.shape[1])

    @property
    def freedom(self) -> int:
        """Readings less unknowns."""
        return 6 * len(self.seen) - 3 * int(self.displacement.shape[1]) - 6 * int(self.target.max() + 1)

    def predicted(self, axes: FloatArray, poses: FloatArray) -> FloatArray:
        """(n, 4, 4) camera_from_target."""
        return transforms.rigid(np.eye(3), -self.displacement @ axes.T) @ poses[self.target]


@dataclass(frozen=True, eq=False)
class StageSolution:
    """What fits best.

    Attributes:
        axes: (3, m) camera frame.
        poses: (k, 4, 4) camera_from_target at the reference.
        covariance: (3 m + 6 k, 3 m + 6 k) of axes, one after the other, and of small motions of the poses.
        residual: (n, 6) small motions from the fitted poses to those seen.
        chi_square: in units of their sigmas.
    """

    axes: FloatArray
    poses: FloatArray
    covariance: FloatArray
    residual: FloatArray
    chi_square: float


def solved(problem: StageProblem, jitter_m: float = 0.0) -> StageSolution:
    """Fit axes and poses, with the camera straying by `jitter_m` per direction from where the stage says it is."""
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
    return StageSolution(
        axes, poses, np.asarray(normal), residual, float(np.sum((inverse_root @ residual.ravel()) ** 2))
    )


def _start(problem: StageProblem) -> tuple[FloatArray, FloatArray]:
    """Axes from positions alone, and each target pose from the first photograph of it."""
    count = problem.target.max() + 1
    design = np.concatenate([np.eye(count)[problem.target], -problem.displacement], axis=1)
    found = np.linalg.lstsq(design, problem.seen[:, :3, 3], rcond=None)[0]
    first = [int(np.argmax(problem.target == k)) for k in range(count)]
    return found[count:].T, transforms.rigid(problem.seen[first, :3, :3], found[:count])


def _design(problem: StageProblem, axes: FloatArray) -> FloatArray:
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


def with_jitter(problem: StageProblem) -> tuple[float, StageSolution]:
    """The solution whose residuals are as large as expected, by the camera straying as much as that takes."""
    solution = solved(problem)
    if not beyond_chance(solution.chi_square, problem.freedom):
        return 0.0, solution
    low, high = 1e-8, 1.0
    for _ in range(_HALVINGS):
        middle = float(np.sqrt(low * high))
        too_little = solved(problem, middle).chi_square > problem.freedom
        low, high = (middle, high) if too_little else (low, middle)
    return high, solved(problem, high)
