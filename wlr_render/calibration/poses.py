"""Rigid poses with their uncertainty, to first order.

The covariance of `b_from_a` describes a small motion in frame b that follows it: rotation vector (rad), then
translation (m), so that the true pose is `small_motion(delta) @ b_from_a`, where `delta` has this covariance. See T. D.
Barfoot, *State Estimation for Robotics* (2017), section 7.3, where the translation comes first.
"""

from dataclasses import dataclass

import numpy as np
import scipy

from wlr_render.geometry import transforms
from wlr_render.geometry.directions import ARCMIN
from wlr_render.numerics.arrays import FloatArray


def small_motion(delta: FloatArray) -> FloatArray:
    """Return the transform (..., 4, 4) of a rotation vector and translation (..., 6)."""
    return transforms.rigid(transforms.rotations_of_vectors(delta[..., :3]), delta[..., 3:])


def motion_between(before: FloatArray, after: FloatArray) -> FloatArray:
    """Return the motion (..., 6) in frame b from poses `before` to poses `after`, both b_from_a (..., 4, 4)."""
    motion = after @ transforms.inverse(before)
    turn = scipy.spatial.transform.Rotation.from_matrix(motion[..., :3, :3].reshape(-1, 3, 3))
    return np.concatenate([turn.as_rotvec().reshape(*motion.shape[:-2], 3), motion[..., :3, 3]], axis=-1)


def adjoint(b_from_a: FloatArray) -> FloatArray:
    """Return the matrix (..., 6, 6) that transforms a small motion from frame a to frame b."""
    rotation = b_from_a[..., :3, :3]
    result = np.zeros((*b_from_a.shape[:-2], 6, 6))
    result[..., :3, :3] = result[..., 3:, 3:] = rotation
    result[..., 3:, :3] = transforms.cross_matrix(b_from_a[..., :3, 3]) @ rotation
    return result


@dataclass(frozen=True, eq=False)
class Pose:
    """A rigid pose and its uncertainty.

    Attributes:
        b_from_a: (4, 4) the pose.
        covariance: (6, 6) covariance of a small motion in frame b (rad, m).
    """

    b_from_a: FloatArray
    covariance: FloatArray

    @property
    def sigma_arcmin(self) -> FloatArray:
        """Standard deviations (3,) of the rotation about the axes of b, arcminutes."""
        return np.sqrt(np.diag(self.covariance)[:3]) / ARCMIN

    @property
    def sigma_mm(self) -> FloatArray:
        """Standard deviations (3,) of the position of a's origin along the axes of b, millimetres."""
        by_motion = np.concatenate([-transforms.cross_matrix(self.b_from_a[:3, 3]), np.eye(3)], axis=1)
        return 1e3 * np.sqrt(np.diag(by_motion @ self.covariance @ by_motion.T))
