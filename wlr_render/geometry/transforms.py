"""Rigid transforms as 4x4 matrices and rotations as quaternions xyzw.

A transform is named by its frames: `point_in_world = apply(world_from_device, point_in_device)`.
"""

import numpy as np
import scipy

from wlr_render.numerics.arrays import FloatArray

OPENXR_FROM_OPENCV = np.diag([1.0, -1.0, -1.0])
"""Rotation from axes x right, y down, z forward to x right, y up, z backward; its own inverse."""
FRAMES = {"openxr": np.eye(3), "opencv": OPENXR_FROM_OPENCV}
"""Rotation to the axes of the device frame from the axes that a file uses, by the name of the latter."""


def rigid(rotation: FloatArray, translation: FloatArray) -> FloatArray:
    """Return the rigid transforms (..., 4, 4) of rotations (..., 3, 3) and translations (..., 3)."""
    rotation, translation = np.asarray(rotation), np.asarray(translation)
    shape: tuple[int, ...] = ()
    if rotation.ndim > 2 or translation.ndim > 1:
        shape = np.broadcast_shapes(rotation.shape[:-2], translation.shape[:-1])
    matrix = np.zeros((*shape, 4, 4))
    matrix[..., :3, :3] = rotation
    matrix[..., :3, 3] = translation
    matrix[..., 3, 3] = 1.0
    return matrix


def is_rotation(matrix: FloatArray) -> bool:
    """Return whether a matrix (3, 3) is orthogonal to 1e-6 with determinant +1."""
    return bool(np.abs(matrix @ matrix.T - np.eye(3)).max() < 1e-6 and np.linalg.det(matrix) > 0)


def inverse(b_from_a: FloatArray) -> FloatArray:
    """Return the inverse (..., 4, 4) of rigid transforms."""
    a_from_b_rotation = np.swapaxes(b_from_a[..., :3, :3], -1, -2)
    return rigid(a_from_b_rotation, -(a_from_b_rotation @ b_from_a[..., :3, 3:])[..., 0])


def apply(b_from_a: FloatArray, point_in_a: FloatArray) -> FloatArray:
    """Transform points (..., 3) by one transform (4, 4)."""
    return np.asarray(point_in_a @ b_from_a[:3, :3].T + b_from_a[:3, 3])


def rotate(b_from_a: FloatArray, direction_in_a: FloatArray) -> FloatArray:
    """Rotate directions (..., 3) by the rotation of one transform (4, 4) or (3, 3)."""
    return np.asarray(direction_in_a @ b_from_a[:3, :3].T)


def rotation_about(axis: str, angle: float) -> FloatArray:
    """Return the right-handed rotation (3, 3) about "x", "y" or "z" by `angle` radians."""
    c, s = np.cos(angle), np.sin(angle)
    i = "xyz".index(axis)
    j, k = (i + 1) % 3, (i + 2) % 3
    rotation = np.eye(3)
    rotation[j, j] = rotation[k, k] = c
    rotation[j, k], rotation[k, j] = -s, s
    return rotation


def cross_matrix(vector: FloatArray) -> FloatArray:
    """Return the matrices (..., 3, 3) that take w to vector x w, of vectors (..., 3)."""
    vector = np.asarray(vector)
    matrix = np.zeros((*vector.shape, 3))
    for row, column, of in ((2, 1, 0), (0, 2, 1), (1, 0, 2)):
        matrix[..., row, column] = vector[..., of]
        matrix[..., column, row] = -vector[..., of]
    return matrix


def rotations_of_vectors(vector: FloatArray) -> FloatArray:
    """Return the rotation matrices (..., 3, 3) of rotation vectors (..., 3) in radians."""
    vector = np.asarray(vector, dtype=np.float64)
    return _matrices(scipy.spatial.transform.Rotation.from_rotvec(vector.reshape(-1, 3)), vector.shape[:-1])


def rotation_of_quaternion(xyzw: FloatArray) -> FloatArray:
    """Return the rotation matrices (..., 3, 3) of quaternions xyzw (..., 4)."""
    xyzw = np.asarray(xyzw, dtype=np.float64)
    return _matrices(scipy.spatial.transform.Rotation.from_quat(xyzw.reshape(-1, 4)), xyzw.shape[:-1])


def between(first: FloatArray, last: FloatArray, fraction: FloatArray) -> FloatArray:
    """Interpolate rigid transforms (n, 4, 4) between one (4, 4) and another, at `fraction` (n,).

    Spherical linear interpolation of the rotation, linear interpolation of the translation.
    """
    vector = scipy.spatial.transform.Rotation.from_matrix(first[:3, :3].T @ last[:3, :3]).as_rotvec()
    rotated = first[:3, :3] @ rotations_of_vectors(fraction[:, None] * vector)
    return rigid(rotated, first[:3, 3] + fraction[:, None] * (last[:3, 3] - first[:3, 3]))


def _matrices(rotations: "scipy.spatial.transform.Rotation", shape: tuple[int, ...]) -> FloatArray:
    return np.asarray(rotations.as_matrix().reshape(*shape, 3, 3))
