"""Fit a see-through model to captures."""

import numpy as np

from wlr_render.calibration.label_terms import board_terms, drift_term, stage_labels
from wlr_render.calibration.model_kinds import ModelKind, Side
from wlr_render.calibration.readings import (
    FitReadings,
    Limits,
    Respond,
    Trend,
    angular_metric,
    common_of,
    motion_of,
    without_thickness,
)
from wlr_render.captures.correspondences import SeeThroughCaptures
from wlr_render.error_sources import ErrorSource
from wlr_render.errors import BadInputError
from wlr_render.geometry.planes import BasePlane
from wlr_render.models.fitted_model import FittedSeeThrough
from wlr_render.models.model_place import NOWHERE, VIEWPOINT, ModelPlace, OwnPlace
from wlr_render.models.see_through_model import SeeThroughModel
from wlr_render.models.spread import Covariance
from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.polynomial import Polynomial

SEE_THROUGH_LIMITS = (Limits(6, 4, 6), Limits(8, 5, 8), Limits(pixel=12, place=6, total=12))
"""Limits of the first fit and of all fits, lower than for the display, because deviations are smoother."""


def _on_plane(captures: SeeThroughCaptures, place: BasePlane, limits: Limits, trend: Trend | None) -> FitReadings:
    tangents = captures.tangents
    depth_to_plane = place.depth_along(captures.viewpoint, tangents)
    in_plane = captures.viewpoint[:, :2] + depth_to_plane[:, None] * tangents
    depth = (place.z_at(in_plane) - captures.point[:, 2])[:, None]
    carried = place.carry_by_tangents(depth_to_plane, tangents)

    def respond(slope: FloatArray, turned: FloatArray, rows: slice) -> FloatArray:
        """Return the change of (P - p~) / Z - t minus the deviation at (p~, t), as p~ and t move with the camera."""
        by_shift = place.carry_by_point(tangents[rows])
        by_place = -np.eye(2) / depth[rows, :, None] - slope[:, :, :2]
        by_tangents = -np.eye(2) - slope[:, :, 2:]
        return np.concatenate([by_place @ by_shift, by_place @ carried[rows] @ turned + by_tangents @ turned], axis=2)

    straight = (captures.point[:, :2] - in_plane) / depth
    return _readings(captures, in_plane, straight, depth, respond, limits, trend)


def _in_volume(captures: SeeThroughCaptures, place: OwnPlace, limits: Limits, trend: Trend | None) -> FitReadings:
    """Return readings with the straight line from viewpoint to point, as tangents (n, 2) and depth (n, 1)."""
    depth = captures.viewpoint[:, 2:] - captures.point[:, 2:]
    straight = (captures.point[:, :2] - captures.viewpoint[:, :2]) / depth

    def respond(slope: FloatArray, turned: FloatArray, rows: slice) -> FloatArray:
        by_shift = -_by_point(straight[rows])
        by_tangents = -np.eye(2) - slope[:, :, 3:]
        return np.concatenate([by_shift / depth[rows, :, None] - slope[:, :, :3], by_tangents @ turned], axis=2)

    at_place = place.carry(captures.viewpoint, captures.tangents)
    moves = respond if place.coordinates else None
    return _readings(captures, at_place, straight, depth, moves, limits, trend)


def _by_point(straight: FloatArray) -> FloatArray:
    """Return the derivative (n, 2, 3) of tangents (n, 2) of a line by its far end, times the far end's depth."""
    return np.concatenate([np.tile(np.eye(2), (len(straight), 1, 1)), straight[:, :, None]], axis=2)


def _readings(
    captures: SeeThroughCaptures,
    place: FloatArray,
    straight: FloatArray,
    depth: FloatArray,
    respond: Respond | None,
    limits: Limits,
    trend: Trend | None,
) -> FitReadings:
    """Return readings of straight (n, 2) - tangents = A(place, tangents) + B(place, tangents) / depth.

    `straight` is the tangents of the straight line from place to point.
    """
    places = place.shape[1]

    def by_point(rows: slice) -> FloatArray:
        """Return the derivative of (P - p~) / Z - t by the point; B / Z changes with depth only to second order."""
        return _by_point(straight[rows]) / depth[rows, :, None]

    visits, capture = captures.visits
    place = without_thickness(place) if places and trend is None else place
    metric, dot = angular_metric(captures.tangents), captures.target_point[:, :2]
    is_noisy = bool(np.any(captures.sigma_arcmin > 0))
    is_pose_fitted = captures.common is not None and ErrorSource.TARGETS in captures.common.sources
    drift = drift_term(captures.time_s, captures.tangents, metric)
    of_board = board_terms(dot, captures.point, captures.target_pose, by_point(slice(None)), is_pose_fitted)
    terms = [each for each in (*of_board, drift) if each is not None and is_noisy]
    return FitReadings(
        inputs=np.hstack([place, captures.tangents]),
        is_place=np.array([True] * places + [False, False]),
        observed=straight - captures.tangents,
        multiplier=np.hstack([np.ones_like(depth), 1.0 / depth]),
        metric=metric,
        sigma=captures.sigma_arcmin,
        capture=capture,
        motion=respond and motion_of(captures.tangents, respond),
        orders=limits.orders(2, places)[:, np.roll(np.arange(2 + places), places)],
        trend=trend,
        motion_prior=captures.motion and captures.motion.of(visits),
        common=respond and common_of(captures, respond, by_point),
        axis_terms=tuple(each for each in terms if each.columns.ndim == 2),
        joint_terms=tuple(each for each in terms if each.columns.ndim == 3),
        stage=stage_labels(captures) if respond else None,
    )


def _model(
    captures: SeeThroughCaptures, place: ModelPlace, deviation: Polynomial, spread: Covariance | None
) -> FittedSeeThrough:
    return SeeThroughModel(captures.eye_box, place, deviation, spread)


def _check(captures: SeeThroughCaptures, kind: str, place: ModelPlace) -> None:
    if isinstance(place, BasePlane) and np.any(place.height_of(captures.point) >= 0):
        raise BadInputError(
            f"the base plane, z = {place.z:g} m, lies beyond some target points; correct the eye box or the base plane."
        )
    poses = len(np.unique(captures.target_pose))
    if poses < 2 and not SEE_THROUGH.kinds[kind].is_trend_alone:
        raise SEE_THROUGH.undetermined(
            kind, "all real points are of one target pose, and it needs two depths: add a pose nearer or farther"
        )


def _lacking(captures: SeeThroughCaptures, kind: str) -> str:
    return (
        "the real points lie in one line of sight or at one depth; spread them over the field, and photograph the "
        "target nearer and farther"
    )


SEE_THROUGH: Side[SeeThroughCaptures, FittedSeeThrough] = Side(
    "see-through",
    "direction",
    {
        "planar": ModelKind(_on_plane, _model),
        "volumetric": ModelKind(_in_volume, _model, VIEWPOINT),
        "static": ModelKind(_in_volume, _model, NOWHERE),
        "grey-box": ModelKind(_on_plane, _model, needs_trend=True),
        "prescription": ModelKind(_on_plane, _model, needs_trend=True, is_trend_alone=True),
    },
    SEE_THROUGH_LIMITS,
    _check,
    _lacking,
)
fit_see_through = SEE_THROUGH.fit
"""Fit a see-through model, the deviation from straight rays, to captures at two or more target depths.

A trend is (x m, y m, tx, ty) -> (A, B) on the base plane.
"""
