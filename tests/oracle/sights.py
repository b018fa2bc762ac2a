"""The directions in which a point of the world, and a point of the panel, are seen through a bench's optics."""

import numpy as np

from oracle.devices import SEE_THROUGH_UM
from oracle.own_tracer import FloatArray, unit
from oracle.world import World

_AIM_STEPS = 25
_AIM_MM = 1e-9
_SHOW_STEPS = 12
_SHOW_PX = 1e-8
_TANGENT_STEP = 1e-6


def forward(tangents: FloatArray) -> FloatArray:
    """Unit directions (n, 3) of tangents x / z, y / z (n, 2)."""
    return unit(np.concatenate([tangents, np.ones((len(tangents), 1))], axis=-1))


def of_point(world: World, eye: FloatArray, point: FloatArray) -> FloatArray:
    """Unit directions (n, 3) in which eyes (n, 3) see points (n, 3) through the optics; NaN where they do not.

    Each round aims by as much beside the point as the last one missed it; the optics bend rays so little that the
    miss shrinks about a hundredfold.
    """
    gap = point - eye
    tangents = gap[:, :2] / gap[:, 2:]
    for _ in range(_AIM_STEPS):
        direction = forward(tangents)
        origin, beyond = world.device.trace(world.device.see_through, eye, direction, SEE_THROUGH_UM)
        for element in world.beyond:
            origin = element(origin, beyond)
        along = (point[:, 2] - origin[:, 2]) / beyond[:, 2]
        miss = (point - origin - along[:, None] * beyond)[:, :2]
        tangents = tangents + miss / gap[:, 2:]
        if not np.any(np.abs(miss) > _AIM_MM):
            break
    return np.where(np.all(np.abs(miss) <= _AIM_MM, axis=-1)[:, None], direction, np.nan)


def pixel_seen(world: World, eye: FloatArray, direction: FloatArray) -> FloatArray:
    """Panel pixels (n, 2) that eyes (n, 3) see in directions (n, 3)."""
    ray = world.device.trace(world.device.display, eye, direction, SEE_THROUGH_UM)
    return world.device.panel.pixel(*ray)


def of_pixel(world: World, eye: FloatArray, pixel: FloatArray, near: FloatArray) -> FloatArray:
    """Unit directions (n, 3) in which eyes (n, 3) see panel pixels (n, 2); NaN where they do not.

    Newton's method on the tangents from directions (n, 3) that are near.
    """
    tangents = near[:, :2] / near[:, 2:]
    for _ in range(_SHOW_STEPS):
        miss = pixel_seen(world, eye, forward(tangents)) - pixel
        if not np.any(np.abs(miss) > _SHOW_PX):
            break
        columns = [
            (pixel_seen(world, eye, forward(tangents + step)) - pixel - miss) / _TANGENT_STEP
            for step in _TANGENT_STEP * np.eye(2)
        ]
        jacobian = np.stack(columns, axis=-1)
        lost = ~np.isfinite(jacobian).all(axis=(1, 2))
        jacobian[lost] = np.eye(2)
        tangents = tangents - np.linalg.solve(jacobian, miss[:, :, None])[:, :, 0]
    return np.where(np.all(np.abs(miss) <= _SHOW_PX, axis=-1)[:, None], forward(tangents), np.nan)
