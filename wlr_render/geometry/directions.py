"""Unit directions, their tangents, and angles between them. In the device frame, the wearer looks along -z."""

import numpy as np

from wlr_render.numerics.arrays import FloatArray

ARCMIN = np.pi / 180 / 60
"""One arcminute in radians."""


def normalised(vector: FloatArray) -> FloatArray:
    """Scale vectors (..., 3) to unit length."""
    return np.asarray(vector / np.linalg.norm(vector, axis=-1, keepdims=True))


def tangents_of_dir(direction: FloatArray) -> FloatArray:
    """Convert directions (..., 3) to tangents (..., 2): (x, y) of their intersections with the plane z = -1.

    NaN for directions that do not look forward (z >= 0).
    """
    depth = np.where(direction[..., 2] < 0, -direction[..., 2], np.nan)
    return np.asarray(direction[..., :2] / depth[..., None])


def dir_of_tangents(tangents: FloatArray) -> FloatArray:
    """Convert tangents (..., 2) to unit directions (..., 3) through (tx, ty, -1)."""
    tx, ty = tangents[..., 0], tangents[..., 1]
    scale = 1.0 / np.sqrt(tx * tx + ty * ty + 1.0)
    return np.stack([tx * scale, ty * scale, -scale], axis=-1)


def angle_between(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return the angle in radians between unit directions (..., 3); accurate for small angles, unlike arccos."""
    chord = np.linalg.norm(first - second, axis=-1)
    return np.asarray(2.0 * np.arcsin(np.minimum(0.5 * chord, 1.0)))


def arcmin_between(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return the angle in arcminutes between unit directions (..., 3)."""
    return angle_between(first, second) / ARCMIN


def tangents_by_turn(tangents: FloatArray) -> FloatArray:
    """Return the derivative (n, 2, 3) of tangents (n, 2) by rotations of their directions about x, y, z, in radians."""
    (tx, ty), one = tangents.T, np.ones(len(tangents))
    by_turn = [[tx * ty, -(one + tx**2), -ty], [one + ty**2, -tx * ty, tx]]
    return np.moveaxis(np.array(by_turn), -1, 0)


def dir_by_tangents(tangents: FloatArray) -> FloatArray:
    """Return the derivative (..., 3, 2) of the unit direction by its tangents (..., 2)."""
    direction = dir_of_tangents(tangents)
    length = np.sqrt(1.0 + np.sum(tangents**2, axis=-1))[..., None, None]
    return np.asarray((np.eye(3)[:, :2] - direction[..., :, None] * direction[..., None, :2]) / length)
