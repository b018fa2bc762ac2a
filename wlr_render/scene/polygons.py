"""Triangles of polygons, convex or not, and smooth normals of triangles."""

import numpy as np
from numpy.typing import NDArray

from wlr_render.numerics.arrays import FloatArray

Triangles = NDArray[np.int64]
_MOST_CORNERS = 1000  # largest concave polygon; the time of ear clipping grows with the square


def triangulated(position: FloatArray, polygons: Triangles) -> Triangles:
    """Return triangles (n (k - 2), 3) of polygons (n, k) with corners in `position` (vertices, 3), polygon by polygon.

    Raises:
        ValueError: a concave polygon has more than 1000 corners.
    """
    count, corners = polygons.shape
    fan = np.stack([np.zeros(corners - 2, int), np.arange(1, corners - 1), np.arange(2, corners)], axis=1)
    triangles = polygons[:, fan]
    if corners == 3:
        return triangles.reshape(-1, 3)
    place = position[polygons]
    place = place - place[:, :1]
    normal = np.cross(place, np.roll(place, -1, axis=1)).sum(axis=1)  # Newell's method
    side = place - np.roll(place, 1, axis=1)
    turn = np.einsum("pki,pi->pk", np.cross(side, np.roll(side, -1, axis=1)), normal)
    straight = 1e-9 * np.sum(normal**2, axis=1, keepdims=True)
    for number in np.flatnonzero((turn < -straight).any(axis=1)):
        triangles[number] = polygons[number][_clipped(place[number], normal[number])]
    return triangles.reshape(count * (corners - 2), 3)


def strip_corners(count: int) -> Triangles:
    """Return the triangles (count - 2, 3) of a triangle strip with `count` corners, all with the same winding."""
    first = np.arange(max(count - 2, 0))
    return np.stack([first, first + 1 + first % 2, first + 2 - first % 2], axis=1)


def _clipped(place: FloatArray, normal: FloatArray) -> Triangles:
    """Return the triangles (k - 2, 3) of one concave polygon (k, 3), by ear clipping."""
    if len(place) > _MOST_CORNERS:
        raise ValueError(f"a concave polygon has {len(place)} corners, more than {_MOST_CORNERS}")
    drop = int(np.argmax(np.abs(normal)))
    flat = np.delete(place, drop, axis=1)
    if (normal[drop] < 0) != (drop == 1):
        flat = flat[:, ::-1]
    left, triangles = list(range(len(flat))), []
    while len(left) > 3:
        ear = next((at for at in range(len(left)) if _is_ear(flat, left, at)), 0)
        triangles.append([left[ear - 1], left[ear], left[(ear + 1) % len(left)]])
        del left[ear]
    return np.array([*triangles, left])


def _is_ear(flat: FloatArray, left: list[int], at: int) -> bool:
    """Return whether the corner is convex and no other corner lies in its triangle."""
    corners = [left[at - 1], left[at], left[(at + 1) % len(left)]]
    triangle = flat[corners]
    side = np.roll(triangle, -1, axis=0) - triangle
    if side[0, 0] * side[1, 1] - side[0, 1] * side[1, 0] <= 0:
        return False
    others = flat[[each for each in left if each not in corners]]
    away = others[:, None] - triangle
    inside = (side[:, 0] * away[..., 1] - side[:, 1] * away[..., 0] >= 0).all(axis=1)
    # A corner that coincides with a corner of the triangle, as where a hole is cut open, does not count.
    return not (inside & (np.abs(away).max(axis=2) > 0).all(axis=1)).any()


def smooth_normals(position: FloatArray, triangles: Triangles) -> FloatArray:
    """Return the mean normals (vertices, 3) of the triangles around each vertex, weighted by angle, not normalised."""
    normal = np.zeros(position.shape)
    corners = position[triangles]
    facing = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    doubled_area = np.linalg.norm(facing, axis=1)
    facing /= np.maximum(doubled_area, np.finfo(float).tiny)[:, None]
    for corner in range(3):
        first, second = (corners[:, (corner + step) % 3] - corners[:, corner] for step in (1, 2))
        angle = np.arctan2(doubled_area, np.einsum("ti,ti->t", first, second))
        for axis in range(3):
            normal[:, axis] += np.bincount(triangles[:, corner], facing[:, axis] * angle, len(position))
    return normal
