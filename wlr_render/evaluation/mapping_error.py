"""Mapping against mapping: how far a candidate's answers lie from true ones, in arcminutes and panel pixels.

True answers are asked once, as *observations*, and any number of candidates is judged by them: exact tracing costs far
more than a fitted model. Observations with another `viewpoint` are experiments: `displaced` for errors of eye tracking,
`moved_back` for viewpoints that see the same rays from farther away.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from wlr_render.geometry import directions, rays
from wlr_render.mappings import DisplayMapping, SeeThroughMapping
from wlr_render.numerics.arrays import FloatArray


@dataclass(frozen=True)
class DisplayObservations:
    """Panel pixels as truly seen.

    Attributes:
        viewpoint: (n, 3) metres, device frame.
        pixel: (n, 2).
        view_dir: (n, 3) in which the pixel is seen from the viewpoint.
    """

    viewpoint: FloatArray
    pixel: FloatArray
    view_dir: FloatArray


@dataclass(frozen=True)
class DisplayError:
    """Errors of a display mapping, one per observation; NaN where it has no answer.

    Attributes:
        forward_arcmin: (n,) between the directions of the pixel.
        backward_px: (n,) between the pixels of the true direction.
    """

    forward_arcmin: FloatArray
    backward_px: FloatArray


@dataclass(frozen=True)
class SeeThroughObservations:
    """Real points as truly seen.

    Attributes:
        viewpoint: (n, 3) metres, device frame.
        view_dir: (n, 3) in which the point is seen from the viewpoint.
        real_ray: (n, 6) on which the point lies.
        point: (n, 3).
    """

    viewpoint: FloatArray
    view_dir: FloatArray
    real_ray: FloatArray
    point: FloatArray


@dataclass(frozen=True)
class SeeThroughError:
    """Errors of a see-through mapping, one per observation; NaN where it has no answer.

    Attributes:
        backward_arcmin: (n,) between the directions in which the point is seen.
        forward_arcmin: (n,) between the real rays' directions.
        forward_miss_m: (n,) distance by which the candidate's real ray misses the point.
    """

    backward_arcmin: FloatArray
    forward_arcmin: FloatArray
    forward_miss_m: FloatArray


def observations_of_pixels(truth: DisplayMapping, viewpoint: FloatArray, pixel: FloatArray) -> DisplayObservations:
    """Ask the truth where pixels (..., 2) are seen from viewpoints (..., 3); what it does not see is left out."""
    seen = truth.view_dir_of_pixel(pixel, viewpoint)
    kept = seen.usable
    return DisplayObservations(_rows(viewpoint, kept, 3), _rows(pixel, kept, 2), seen.value[kept])


def observations_of_dirs(truth: DisplayMapping, viewpoint: FloatArray, view_dir: FloatArray) -> DisplayObservations:
    """Ask the truth which pixels are seen in directions (..., 3) from viewpoints (..., 3); none seen, none kept."""
    shown = truth.pixel_of_view_dir(view_dir, viewpoint)
    kept = shown.usable
    return DisplayObservations(_rows(viewpoint, kept, 3), shown.value[kept], _rows(view_dir, kept, 3))


def display_error(candidate: DisplayMapping, observations: DisplayObservations) -> DisplayError:
    """Judge a display mapping by true observations, both ways."""
    shown = candidate.view_dir_of_pixel(observations.pixel, observations.viewpoint)
    pixel = candidate.pixel_of_view_dir(observations.view_dir, observations.viewpoint)
    return DisplayError(
        directions.arcmin_between(shown.value, observations.view_dir),
        np.linalg.norm(pixel.value - observations.pixel, axis=-1),
    )


def see_through_observations(
    truth: SeeThroughMapping, viewpoint: FloatArray, view_dir: FloatArray, depth_m: FloatArray
) -> SeeThroughObservations:
    """Follow directions (..., 3) from viewpoints (..., 3) to points at `depth_m` (...) in front of the viewpoints.

    What the truth does not see is left out. Points must lie beyond the optics.
    """
    seen = truth.real_ray_of_view_dir(view_dir, viewpoint)
    kept = seen.usable
    viewpoints = _rows(viewpoint, kept, 3)
    ray = seen.value[kept]
    depth = np.broadcast_to(depth_m, kept.shape)[kept]
    point = rays.split(rays.at_z(ray, viewpoints[:, 2] - depth))[0]
    return SeeThroughObservations(viewpoints, _rows(view_dir, kept, 3), ray, point)


def see_through_error(candidate: SeeThroughMapping, observations: SeeThroughObservations) -> SeeThroughError:
    """Judge a see-through mapping by true observations, both ways."""
    seen = candidate.view_dir_of_real_point(observations.point, observations.viewpoint)
    ray = candidate.real_ray_of_view_dir(observations.view_dir, observations.viewpoint).value
    return SeeThroughError(
        directions.arcmin_between(seen.value, observations.view_dir),
        directions.arcmin_between(rays.split(ray)[1], rays.split(observations.real_ray)[1]),
        rays.distance_to_point(ray, observations.point),
    )


def straight_error(observations: SeeThroughObservations) -> FloatArray:
    """(n,) arcminutes by which a world without optics differs: what an uncalibrated device is wrong by."""
    straight = directions.normalised(observations.point - observations.viewpoint)
    return directions.arcmin_between(straight, observations.view_dir)


def displaced(observations: DisplayObservations, offset: FloatArray) -> DisplayObservations:
    """The same observations, asked at viewpoints wrong by `offset` (n, 3) metres: an error of eye tracking."""
    return replace(observations, viewpoint=observations.viewpoint + offset)


def moved_back(observations: DisplayObservations, distance_m: float | FloatArray) -> DisplayObservations:
    """The same rays, seen from viewpoints farther back by one distance or (n,); the space before the optics is free."""
    return displaced(observations, -np.asarray(distance_m)[..., None] * observations.view_dir)


def self_inconsistency_arcmin(
    candidate: DisplayMapping, viewpoint: FloatArray, pixel: FloatArray, distance_m: FloatArray
) -> FloatArray:
    """How much a mapping contradicts itself along its own rays.

    The direction that it gives a pixel (..., 2) at a viewpoint (..., 3) is compared with the one that it gives
    `distance_m` (...) farther back on that very ray, where the direction must be the same.

    Returns:
        (...) arcminutes, zero for any true display; NaN where it has no answer.
    """
    first = candidate.view_dir_of_pixel(pixel, viewpoint).value
    behind = viewpoint - np.asarray(distance_m)[..., None] * first
    return directions.arcmin_between(first, candidate.view_dir_of_pixel(pixel, behind).value)


def _rows(array: FloatArray, kept: NDArray[np.bool_], width: int) -> FloatArray:
    return np.broadcast_to(array, (*kept.shape, width))[kept]
