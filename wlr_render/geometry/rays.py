"""Rays packed as (..., 6): a point, then a unit direction."""

import numpy as np

from wlr_render.numerics.arrays import FloatArray


def pack(origin: FloatArray, direction: FloatArray) -> FloatArray:
    """Pack origins (..., 3) and directions (..., 3) into rays (..., 6)."""
    origin, direction = np.broadcast_arrays(origin, direction)
    return np.concatenate([origin, direction], axis=-1)


def split(ray: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the origins (..., 3) and directions (..., 3) of rays (..., 6)."""
    return ray[..., :3], ray[..., 3:]


def at_z(ray: FloatArray, z: float | FloatArray) -> FloatArray:
    """Move the origin of each ray (..., 6) along its line to the plane z; no ray may be parallel to the plane."""
    origin, direction = split(ray)
    along = (z - origin[..., 2]) / direction[..., 2]
    return pack(origin + along[..., None] * direction, direction)


def distance_to_point(ray: FloatArray, point: FloatArray) -> FloatArray:
    """Return the distance (...) from points (..., 3) to the lines of rays (..., 6)."""
    origin, direction = split(ray)
    offset = point - origin
    along = np.sum(offset * direction, axis=-1, keepdims=True)
    return np.asarray(np.linalg.norm(offset - along * direction, axis=-1))


def transformed(b_from_a: FloatArray, ray_in_a: FloatArray) -> FloatArray:
    """Transform rays (..., 6) by one rigid transform (4, 4)."""
    origin, direction = split(ray_in_a)
    rotation = b_from_a[:3, :3]
    return pack(origin @ rotation.T + b_from_a[:3, 3], direction @ rotation.T)
