"""Exact observations from other viewpoints, and errors that need no exact answer."""

from dataclasses import replace

import numpy as np

from wlr_render.evaluation.mapping_error import DisplayObservations, SeeThroughObservations
from wlr_render.geometry import directions
from wlr_render.mappings import DisplayMapping
from wlr_render.numerics.arrays import FloatArray


def straight_error(observations: SeeThroughObservations) -> FloatArray:
    """Return errors (n,) in arcminutes of straight see-through rays, which an uncalibrated device assumes."""
    straight = directions.normalised(observations.point - observations.viewpoint)
    return directions.arcmin_between(straight, observations.view_dir)


def displaced(observations: DisplayObservations, offset: FloatArray) -> DisplayObservations:
    """Return the same observations with viewpoints wrong by `offset` (n, 3) metres: an error of eye tracking."""
    return replace(observations, viewpoint=observations.viewpoint + offset)


def moved_back(observations: DisplayObservations, distance_m: float | FloatArray) -> DisplayObservations:
    """Return the same rays with viewpoints moved back along them, by one distance or (n,) distances."""
    return displaced(observations, -np.asarray(distance_m)[..., None] * observations.view_dir)


def through_depth(view_dir: FloatArray, depth_m: float) -> FloatArray:
    """Return the length (...) of a ray in direction (..., 3) between two z planes `depth_m` from each other."""
    return np.asarray(depth_m / -view_dir[..., 2])


def self_inconsistency_arcmin(
    candidate: DisplayMapping, viewpoint: FloatArray, pixel: FloatArray, distance_m: FloatArray
) -> FloatArray:
    """Return the self-inconsistency of a mapping along its own rays.

    The direction of a pixel (..., 2) at a viewpoint (..., 3) is compared with its direction at the viewpoint
    `distance_m` (...) farther back on the same ray, where it must be the same.

    Returns:
        Angles (...) in arcminutes, zero for any real display; NaN where the mapping has no value.
    """
    first = candidate.view_dir_of_pixel(pixel, viewpoint).value
    behind = viewpoint - np.asarray(distance_m)[..., None] * first
    return directions.arcmin_between(first, candidate.view_dir_of_pixel(pixel, behind).value)
