"""Generalised least squares for a straight stage, from poses with correlated errors.

A real stage is not straight: its camera departs from the line by some micrometres and rotates by some microradians.
Both are variance components, estimated by restricted maximum likelihood (REML; H. D. Patterson and R. Thompson,
Biometrika 58 (1971) 545).
"""

from dataclasses import dataclass

import numpy as np

from wlr_render.calibration.poses import adjoint, motion_between, motion_rows, small_motion
from wlr_render.errors import BadInputError
from wlr_render.geometry import transforms
from wlr_render.numerics.arrays import FloatArray, IntArray

STILL = 1e-3
"""An axis whose readings vary by less than this part of the largest travel has not moved."""

_STEPS = 4  # of Gauss and Newton; the problem is nearly linear
_JITTER_PER_NOISE = np.geomspace(1e-3, 1e6, 37)  # searched, in units of the noise of the best photograph
_ROUNDS, _CONVERGED = 60, 1e-4  # rounds over both components, until neither changes by more than this part


@dataclass(frozen=True, eq=False)
class StageProblem:
    """Board poses measured at stage readings.

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
        rows = motion_rows(keep)
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
    """Generalised least-squares solution.

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


@dataclass(frozen=True)
class Jitter:
    """Standard deviations of the camera about the straight motion, per photograph and per axis of the camera.

    Attributes:
        rotation_rad: of its rotation about each axis.
        translation_m: of its position along each axis.
    """

    rotation_rad: float = 0.0
    translation_m: float = 0.0

    @property
    def covariance(self) -> FloatArray:
        """(6, 6) of a small motion in the camera's frame."""
        return np.diag(np.repeat([self.rotation_rad**2, self.translation_m**2], 3))


def solve_stage(problem: StageProblem, jitter: Jitter = Jitter()) -> StageSolution:
    """Fit axes and poses to photographs whose camera departs from the straight motion by `jitter`."""
    count, axis_count = problem.displacement.shape
    covariance = problem.covariance + np.kron(np.eye(count), jitter.covariance)
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


def fit_with_jitter(problem: StageProblem) -> tuple[Jitter, StageSolution]:
    """Return the REML estimate of the jitter, and the solution with it.

    Raises:
        BadInputError: the photographs are described better the larger a jitter is.
    """
    start = solve_stage(problem)
    design = _design(problem, start.axes)
    contrasts = np.linalg.qr(design, mode="complete")[0][:, design.shape[1] :]  # free of axes and target poses
    residual = contrasts.T @ start.residual.ravel()
    noise = contrasts.T @ problem.covariance @ contrasts
    by_kind = [contrasts.reshape(-1, 6, contrasts.shape[1])[:, rows] for rows in (slice(0, 3), slice(3, 6))]
    each = [np.einsum("nki,nkj->ij", rows, rows) for rows in by_kind]
    smallest = np.sqrt(np.diag(problem.covariance).reshape(-1, 2, 3).min(axis=(0, 2)))
    sigma = np.zeros(2)
    for _ in range(_ROUNDS):
        before = sigma.copy()
        for kind, name in enumerate(("rotation", "position")):
            rest = noise + sigma[1 - kind] ** 2 * each[1 - kind]
            found = _most_likely_sigma(rest, each[kind], residual, smallest[kind] * _JITTER_PER_NOISE)
            if found is None:
                raise BadInputError(
                    f"the repeatability of the stage in {name} cannot be estimated: photographs without the headset "
                    "disagree by more than a million times their noise; check stage readings, target poses and units."
                )
            sigma[kind] = found
        if np.all(np.abs(sigma - before) <= _CONVERGED * sigma):
            break
    jitter = Jitter(float(sigma[0]), float(sigma[1]))
    return jitter, solve_stage(problem, jitter)


def _most_likely_sigma(
    noise: FloatArray, component: FloatArray, residual: FloatArray, tried: FloatArray
) -> float | None:
    """The sigma at which `residual` (m,) is most likely with covariance `noise + sigma**2 * component`.

    Zero where any of those `tried` (ascending) is less likely than none; None where the last is the most likely.
    """
    from scipy.optimize import minimize_scalar

    inverse_root = np.linalg.inv(np.linalg.cholesky(noise))
    size, vectors = np.linalg.eigh(inverse_root @ component @ inverse_root.T)
    square = (vectors.T @ (inverse_root @ residual)) ** 2

    def minus_two_log_likelihood(log_sigma: FloatArray) -> FloatArray:
        variance = 1.0 + np.exp(2.0 * np.asarray(log_sigma))[..., None] * size
        return np.asarray(np.sum(np.log(variance) + square / variance, axis=-1))

    log_tried = np.log(tried)
    values = minus_two_log_likelihood(log_tried)
    best = int(np.argmin(values))
    if best == len(tried) - 1:
        return None
    if best == 0 or values[best] >= np.sum(square):
        return 0.0
    bracket = (log_tried[best - 1], log_tried[best + 1])
    return float(np.exp(minimize_scalar(minus_two_log_likelihood, bounds=bracket, method="bounded").x))
