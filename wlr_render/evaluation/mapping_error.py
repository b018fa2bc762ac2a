"""Errors of a mapping against exact optics, in arcminutes and panel pixels.

Exact results are computed once, as *observations*, and compared with any number of mappings, because exact tracing
is far slower than a fitted model.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wlr_render.geometry import directions, rays
from wlr_render.mappings import DisplayMapping, Eye, FieldOfView, SeeThroughMapping
from wlr_render.numerics.arrays import FloatArray


@dataclass(frozen=True)
class DisplayObservations:
    """Exact view directions of panel pixels.

    Attributes:
        viewpoint: (n, 3) metres, device frame.
        pixel: (n, 2) panel pixels.
        view_dir: (n, 3) direction of the pixel from the viewpoint.
    """

    viewpoint: FloatArray
    pixel: FloatArray
    view_dir: FloatArray


@dataclass(frozen=True)
class DisplayError:
    """Errors of a display mapping, one per observation; NaN where the mapping has no value.

    Attributes:
        forward_arcmin: (n,) angle between the directions of the pixel.
        backward_px: (n,) distance between the pixels of the exact direction.
    """

    forward_arcmin: FloatArray
    backward_px: FloatArray


@dataclass(frozen=True)
class SeeThroughObservations:
    """Exact view directions of real points.

    Attributes:
        viewpoint: (n, 3) metres, device frame.
        view_dir: (n, 3) direction of the point from the viewpoint.
        real_ray: (n, 6) world ray through the point.
        point: (n, 3) metres, device frame.
    """

    viewpoint: FloatArray
    view_dir: FloatArray
    real_ray: FloatArray
    point: FloatArray


@dataclass(frozen=True)
class SeeThroughError:
    """Errors of a see-through mapping, one per observation; NaN where the mapping has no value.

    Attributes:
        backward_arcmin: (n,) angle between the view directions of the point.
        forward_arcmin: (n,) angle between the directions of the world rays.
        forward_miss_m: (n,) distance between the mapping's world ray and the point.
    """

    backward_arcmin: FloatArray
    forward_arcmin: FloatArray
    forward_miss_m: FloatArray


def observations_of_pixels(truth: DisplayMapping, viewpoint: FloatArray, pixel: FloatArray) -> DisplayObservations:
    """Observe pixels (..., 2) from viewpoints (..., 3) with exact optics; pixels that are not visible are omitted."""
    seen = truth.view_dir_of_pixel(pixel, viewpoint)
    kept = seen.usable
    return DisplayObservations(_rows(viewpoint, kept, 3), _rows(pixel, kept, 2), seen.value[kept])


def observations_of_dirs(truth: DisplayMapping, viewpoint: FloatArray, view_dir: FloatArray) -> DisplayObservations:
    """Observe the pixels in directions (..., 3) from viewpoints (..., 3) with exact optics.

    Directions without a visible pixel are omitted.
    """
    shown = truth.pixel_of_view_dir(view_dir, viewpoint)
    kept = shown.usable
    return DisplayObservations(_rows(viewpoint, kept, 3), shown.value[kept], _rows(view_dir, kept, 3))


def observations_at_random(
    truth: Eye, viewpoint: FloatArray, each: int, rng: np.random.Generator, field: FieldOfView | None
) -> DisplayObservations:
    """Observe `each` random pixels from every viewpoint (n, 1, 3): of the panel, or in a field if one is given."""
    shape = (len(viewpoint), each, 2)
    if field is None:
        pixel = rng.uniform(0.0, 1.0, shape) * truth.display.panel.size_px
        return observations_of_pixels(truth.display, viewpoint, pixel)
    view_dir = directions.dir_of_tangents(rng.uniform(field.low, field.high, shape))
    return observations_of_dirs(truth.display, viewpoint, view_dir)


def display_error(candidate: DisplayMapping, observations: DisplayObservations) -> DisplayError:
    """Compute the errors of a display mapping, forward and backward."""
    shown = candidate.view_dir_of_pixel(observations.pixel, observations.viewpoint)
    pixel = candidate.pixel_of_view_dir(observations.view_dir, observations.viewpoint)
    return DisplayError(
        directions.arcmin_between(shown.value, observations.view_dir),
        np.linalg.norm(pixel.value - observations.pixel, axis=-1),
    )


def see_through_observations(
    truth: SeeThroughMapping, viewpoint: FloatArray, view_dir: FloatArray, depth_m: FloatArray
) -> SeeThroughObservations:
    """Observe real points in directions (..., 3) from viewpoints (..., 3), `depth_m` (...) in front of the viewpoints.

    Directions without a world ray are omitted. Points must be behind the optics.
    """
    seen = truth.real_ray_of_view_dir(view_dir, viewpoint)
    kept = seen.usable
    viewpoints = _rows(viewpoint, kept, 3)
    ray = seen.value[kept]
    depth = np.broadcast_to(depth_m, kept.shape)[kept]
    point = rays.split(rays.at_z(ray, viewpoints[:, 2] - depth))[0]
    return SeeThroughObservations(viewpoints, _rows(view_dir, kept, 3), ray, point)


def see_through_error(candidate: SeeThroughMapping, observations: SeeThroughObservations) -> SeeThroughError:
    """Compute the errors of a see-through mapping, forward and backward."""
    seen = candidate.view_dir_of_real_point(observations.point, observations.viewpoint)
    ray = candidate.real_ray_of_view_dir(observations.view_dir, observations.viewpoint).value
    return SeeThroughError(
        directions.arcmin_between(seen.value, observations.view_dir),
        directions.arcmin_between(rays.split(ray)[1], rays.split(observations.real_ray)[1]),
        rays.distance_to_point(ray, observations.point),
    )


def _rows(array: FloatArray, kept: NDArray[np.bool_], width: int) -> FloatArray:
    return np.broadcast_to(array, (*kept.shape, width))[kept]
