"""Trials of models along rays: behind the eye box, and against themselves at two points of one ray."""

from dataclasses import dataclass, replace
from enum import StrEnum
from typing import ClassVar

import numpy as np

from benchmarks.moved_observations import moved_back, self_inconsistency_arcmin, through_depth
from benchmarks.trials import (
    BACK_M,
    DisplayTrial,
    SeeThroughTrial,
    display_observations,
    see_through_observations,
)
from wlr_render.evaluation import mapping_error
from wlr_render.evaluation.mapping_error import (
    DisplayObservations,
    SeeThroughObservations,
)
from wlr_render.evaluation.metrics import Summary, summary
from wlr_render.geometry import rays
from wlr_render.geometry.directions import arcmin_between
from wlr_render.mappings import DisplayMapping, SeeThroughMapping
from wlr_render.models.fitted_model import FittedDisplay, FittedSeeThrough
from wlr_render.numerics.arrays import FloatArray
from wlr_render.simulation.capture_setup import SeeThroughRays


class DepthMeasure(StrEnum):
    """Errors along the rays of random viewpoints.

    MOVED_BACK: direction of a pixel, or of a real point, from `BACK_M` farther back. The other measures compare a
    model's results, which must be equal, at two points of one of its rays at a distance of the eye box's depth.
    ALONG_RAY: forward query, the direction of a pixel, or of the world ray of a view direction. OFFSET_ALONG_RAY:
    distance of that world ray from the first world ray's point at the depth of the real point. PIXEL_ALONG_RAY and
    POINT_ALONG_RAY: backward query, the pixel of a view direction, and the view direction of a real point.
    """

    MOVED_BACK = "moved back (arcmin)"
    ALONG_RAY = "along a ray (arcmin)"
    OFFSET_ALONG_RAY = "offset along a ray (mm)"
    PIXEL_ALONG_RAY = "pixel along a ray (px)"
    POINT_ALONG_RAY = "real point along a ray (arcmin)"


@dataclass(frozen=True)
class DepthTrial(DisplayTrial):
    """A trial of the display model that is also evaluated along its rays."""

    def errors(self, model: FittedDisplay, rng: np.random.Generator, seed: int) -> dict[str, Summary]:
        """Return the errors of a fitted model, in the eye box and along rays."""
        seen = display_observations(self.at, seed)
        back = moved_back(seen, BACK_M)
        shown = model.view_dir_of_pixel(back.pixel, back.viewpoint).value
        through = _through(self, seen.view_dir)
        front = moved_back(seen, -0.5 * through)
        return super().errors(model, rng, seed) | {
            DepthMeasure.MOVED_BACK: summary(arcmin_between(shown, back.view_dir)),
            DepthMeasure.ALONG_RAY: summary(self_inconsistency_arcmin(model, front.viewpoint, seen.pixel, through)),
            DepthMeasure.PIXEL_ALONG_RAY: summary(pixel_inconsistency_px(model, front, through)),
        }


@dataclass(frozen=True)
class SeeThroughDepthTrial(SeeThroughTrial):
    """A trial of the see-through model, captured forwards as in the paper, that is also evaluated along its rays."""

    RAYS: ClassVar[SeeThroughRays] = "forward"

    def errors(self, model: FittedSeeThrough, seed: int) -> dict[str, Summary]:
        """Return the errors of a fitted model, in the eye box and along rays."""
        seen = see_through_observations(self.at, seed)
        back = mapping_error.see_through_error(model, see_through_moved_back(seen, BACK_M))
        through = _through(self, seen.view_dir)
        front = see_through_moved_back(seen, -0.5 * through)
        angle, offset = world_ray_inconsistency(model, front, through)
        return super().errors(model, seed) | {
            DepthMeasure.MOVED_BACK: summary(back.backward_arcmin),
            DepthMeasure.ALONG_RAY: summary(angle),
            DepthMeasure.OFFSET_ALONG_RAY: summary(1e3 * offset),
            DepthMeasure.POINT_ALONG_RAY: summary(real_point_inconsistency_arcmin(model, front, through)),
        }


def _through(trial: DisplayTrial | SeeThroughTrial, view_dir: FloatArray) -> FloatArray:
    return through_depth(view_dir, 1e-3 * trial.eye_box_mm[2])


def see_through_moved_back(
    observations: SeeThroughObservations, distance_m: float | FloatArray
) -> SeeThroughObservations:
    """Return the same points and rays with viewpoints moved back along their view rays, by one or (n,) distances."""
    return replace(observations, viewpoint=_behind(observations.viewpoint, observations.view_dir, distance_m))


def _behind(viewpoint: FloatArray, view_dir: FloatArray, distance_m: float | FloatArray) -> FloatArray:
    return np.asarray(viewpoint - np.asarray(distance_m)[..., None] * view_dir)


def pixel_inconsistency_px(
    candidate: DisplayMapping, observations: DisplayObservations, distance_m: FloatArray
) -> FloatArray:
    """Return the distance (n,) in pixels between the pixels of a view direction at two viewpoints on one ray."""
    first = candidate.pixel_of_view_dir(observations.view_dir, observations.viewpoint).value
    behind = moved_back(observations, distance_m).viewpoint
    second = candidate.pixel_of_view_dir(observations.view_dir, behind).value
    return np.asarray(np.linalg.norm(second - first, axis=-1))


def world_ray_inconsistency(
    candidate: SeeThroughMapping, observations: SeeThroughObservations, distance_m: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return angle and distance between the world rays of a view direction at two viewpoints on one view ray.

    Returns:
        (n,) arcminutes; and (n,) metres from the second ray to the point of the first at the depth of the real point.
    """
    first = candidate.real_ray_of_view_dir(observations.view_dir, observations.viewpoint).value
    behind = see_through_moved_back(observations, distance_m).viewpoint
    second = candidate.real_ray_of_view_dir(observations.view_dir, behind).value
    point = rays.split(rays.at_z(first, observations.point[:, 2]))[0]
    angle = arcmin_between(rays.split(first)[1], rays.split(second)[1])
    return angle, rays.distance_to_point(second, point)


def real_point_inconsistency_arcmin(
    candidate: SeeThroughMapping, observations: SeeThroughObservations, distance_m: FloatArray
) -> FloatArray:
    """Return the angle (n,) between view directions of a real point at two viewpoints on one view ray of the model."""
    first = candidate.view_dir_of_real_point(observations.point, observations.viewpoint).value
    behind = _behind(observations.viewpoint, first, distance_m)
    return arcmin_between(first, candidate.view_dir_of_real_point(observations.point, behind).value)
