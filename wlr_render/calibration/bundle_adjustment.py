"""Bundle adjustment of a lens and board poses: Gauss-Newton with block-arrow normal equations.

Each pose meets the others only through the lens, so poses are eliminated first (Schur complement; B. Triggs et al.,
"Bundle adjustment: a modern synthesis" (2000), section 6).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from wlr_render.calibration.board_poses import BoardView, Reprojection, reproject
from wlr_render.calibration.poses import small_motion
from wlr_render.geometry.lens_camera import LENS_PARAMETERS, LensCamera
from wlr_render.numerics.arrays import FloatArray, IntArray

_STEPS = 50
_SETTLED = 1e-3  # of a sigma, all values together
_INDEPENDENT = 1e-10  # smallest eigenvalue of scaled normal equations that still tells something


class UndeterminedError(ValueError):
    """The views do not determine a lens parameter, or the adjustment does not converge."""


@dataclass(frozen=True, eq=False)
class _Normal:
    """Solved normal equations.

    Attributes:
        lens_step: (m,) of the free values.
        pose_step: (n, 6).
        lens_covariance: (m, m), for dots of unit sigma.
        pose_covariance: (n, 6, 6) each pose's own, with the lens known.
        pose_by_lens: (n, 6, m) how poses follow an error of the lens.
        gain: what the step lowers the sum of squares by.
    """

    lens_step: FloatArray
    pose_step: FloatArray
    lens_covariance: FloatArray
    pose_covariance: FloatArray
    pose_by_lens: FloatArray
    gain: float


@dataclass(frozen=True, eq=False)
class Adjustment:
    """An adjusted lens and its poses.

    Attributes:
        camera: the lens.
        camera_from_board: (n, 4, 4).
        views: n.
        parts: their residuals.
        free: (m,) indices into `LENS_PARAMETERS`, of those adjusted.
        noise: rms residual in units of the dots' sigmas, for the unknowns spent.
        lens_covariance: (m, m), with the noise found.
        covariance: (6 n, 6 n) of small motions of all poses in the camera's frame, with the noise found.
    """

    camera: LensCamera
    camera_from_board: FloatArray
    views: Sequence[BoardView]
    parts: Sequence[Reprojection]
    free: IntArray
    noise: float
    lens_covariance: FloatArray
    covariance: FloatArray

    @property
    def rms_px(self) -> FloatArray:
        """(n,) rms distance of dots per axis, pixels."""
        return np.array([part.rms_px for part in self.parts])


def adjust_bundle(
    camera: LensCamera, camera_from_board: FloatArray, views: Sequence[BoardView], free: IntArray
) -> Adjustment:
    """Fit the `free` parameters of a lens and the poses (n, 4, 4) to the views.

    Raises:
        UndeterminedError: the views do not determine the values, or there is no end to the steps.
    """
    for _ in range(_STEPS):
        parts = [reproject(camera, pose, view) for pose, view in zip(camera_from_board, views, strict=True)]
        normal = _solved(parts, free)
        if normal.gain < _SETTLED**2:
            break
        camera = _moved(camera, normal.lens_step, free)
        camera_from_board = small_motion(normal.pose_step) @ camera_from_board
    else:
        raise UndeterminedError("the adjustment does not settle")
    unknowns = len(free) + 6 * len(views)
    readings = sum(len(part.residual) for part in parts)
    noise = np.sqrt(sum(part.chi_square for part in parts) / (readings - unknowns))
    lens_covariance = noise**2 * normal.lens_covariance
    follows = normal.pose_by_lens.reshape(-1, len(free))
    covariance = follows @ lens_covariance @ follows.T
    for i, own in enumerate(normal.pose_covariance):
        covariance[6 * i : 6 * i + 6, 6 * i : 6 * i + 6] += noise**2 * own
    return Adjustment(camera, camera_from_board, views, parts, free, float(noise), lens_covariance, covariance)


def _solved(parts: Sequence[Reprojection], free: IntArray) -> _Normal:
    by_lens = [part.by_camera[:, free] for part in parts]
    own = np.array([np.linalg.inv(part.by_motion.T @ part.by_motion) for part in parts])
    cross = np.array([part.by_motion.T @ lens for part, lens in zip(parts, by_lens, strict=True)])
    pull = np.array([part.by_motion.T @ part.residual for part in parts])
    lens_pull = np.sum([lens.T @ part.residual for part, lens in zip(parts, by_lens, strict=True)], axis=0)
    follows = -own @ cross
    reduced = np.sum([lens.T @ lens for lens in by_lens], axis=0) + np.einsum("nij,nik->jk", cross, follows)
    reduced_pull = lens_pull + np.einsum("nij,ni->j", follows, pull)
    lens_covariance = _inverse(reduced)
    lens_step = lens_covariance @ reduced_pull
    alone = np.einsum("nij,nj->ni", own, pull)
    return _Normal(
        lens_step,
        alone + follows @ lens_step,
        lens_covariance,
        own,
        follows,
        float(lens_step @ reduced_pull + np.sum(alone * pull)),
    )


def _inverse(matrix: FloatArray) -> FloatArray:
    """Of a symmetric matrix whose rows have unlike units."""
    with np.errstate(invalid="ignore", divide="ignore"):
        scale = 1.0 / np.sqrt(np.diag(matrix))
    scaled = matrix * scale * scale[:, None]
    if not np.all(np.isfinite(scaled)) or np.linalg.eigvalsh(scaled)[0] < _INDEPENDENT:
        raise UndeterminedError("the views leave a value of the lens open")
    return np.asarray(np.linalg.inv(scaled) * scale * scale[:, None])


def _moved(camera: LensCamera, step: FloatArray, free: IntArray) -> LensCamera:
    whole = np.zeros(len(LENS_PARAMETERS))
    whole[free] = step
    return LensCamera(
        camera.size_px, camera.focal_px + whole[:2], camera.centre_px + whole[2:4], camera.distortion + whole[4:]
    )
