"""Fit a display model to captures."""

import numpy as np

from wlr_render.calibration.label_terms import drift_term, stage_labels
from wlr_render.calibration.model_kinds import ModelKind, Side
from wlr_render.calibration.readings import (
    FitReadings,
    Limits,
    Trend,
    angular_metric,
    common_of,
    motion_of,
    without_thickness,
)
from wlr_render.captures.correspondences import DisplayCaptures
from wlr_render.geometry.planes import BasePlane
from wlr_render.models.display_model import DisplayModel
from wlr_render.models.fitted_model import FittedDisplay
from wlr_render.models.inverse import backward_start_of
from wlr_render.models.model_place import NOWHERE, VIEWPOINT, ModelPlace
from wlr_render.models.point_per_pixel import PointPerPixelDisplay
from wlr_render.models.spread import Covariance
from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.polynomial import Polynomial

DISPLAY_LIMITS = (Limits(8, 5, 8), Limits(10, 5, 10), Limits(pixel=12, place=6, total=12))
"""Limits of the first fit and of all fits; further fits use the terms between these limits that matter."""


def _readings(captures: DisplayCaptures, place: ModelPlace, limits: Limits, trend: Trend | None) -> FitReadings:
    tangents, places = captures.tangents, place.coordinates
    carried = place.carry_by_tangents(place.depth_along(captures.viewpoint, tangents), tangents)
    at_place = place.carry(captures.viewpoint, tangents)

    def respond(slope: FloatArray, turned: FloatArray, rows: slice) -> FloatArray:
        """Return the change of t - f(pixel, place) with a shift of the camera and a change of the tangents."""
        by_place = slope[:, :, 2:]
        shifted = place.carry_by_point(tangents[rows])
        return np.concatenate([-by_place @ shifted, turned - by_place @ carried[rows] @ turned], axis=2)

    visits, capture = captures.visits
    at_place = without_thickness(at_place) if places and trend is None else at_place
    metric, moves = angular_metric(tangents), respond if places else None
    drift = drift_term(captures.time_s, tangents, metric)
    return FitReadings(
        inputs=np.hstack([captures.pixel, at_place]),
        is_place=np.array([False, False] + [True] * places),
        observed=tangents,
        multiplier=np.ones((len(captures), 1)),
        metric=metric,
        sigma=captures.sigma_arcmin,
        capture=capture,
        motion=moves and motion_of(tangents, moves),
        orders=limits.orders(2, places),
        trend=trend,
        motion_prior=captures.motion and captures.motion.of(visits),
        common=moves and common_of(captures, moves),
        axis_terms=() if drift is None or not np.any(captures.sigma_arcmin > 0) else (drift,),
        stage=stage_labels(captures) if moves else None,
    )


def _of_points(captures: DisplayCaptures, place: ModelPlace, limits: Limits, trend: Trend | None) -> FitReadings:
    """Return readings of t = a - w q, linear in the unknowns a and w.

    The intersection q of the measured ray with the nominal plane is known.
    """
    tangents, centre = captures.tangents, captures.eye_box.centre
    crossing = BasePlane(float(centre[2])).carry(captures.viewpoint, tangents) - centre[:2]
    multiplier = np.zeros((len(captures), 2, 3))
    multiplier[:, 0, 0] = multiplier[:, 1, 1] = 1.0
    multiplier[:, :, 2] = -crossing
    return FitReadings(
        inputs=captures.pixel,
        is_place=np.array([False, False]),
        observed=tangents,
        multiplier=multiplier,
        metric=angular_metric(tangents),
        sigma=captures.sigma_arcmin,
        capture=np.unique(captures.capture, return_inverse=True)[1],
        motion=None,
        orders=limits.orders(2, 0),
    )


def _model(
    captures: DisplayCaptures, place: ModelPlace, forward: Polynomial, spread: Covariance | None
) -> FittedDisplay:
    return DisplayModel(captures.panel, captures.eye_box, place, forward, backward_start_of(forward), spread)


def _points(captures: DisplayCaptures, _: ModelPlace, point: Polynomial, spread: Covariance | None) -> FittedDisplay:
    return PointPerPixelDisplay(captures.panel, captures.eye_box, point, spread)


def _lacking(captures: DisplayCaptures, kind: str) -> str:
    places = len(np.unique(captures.capture))
    if kind == "point-per-pixel" and places < 2:
        return f"a point in space needs two camera positions at least and there is {places}: add one beside it"
    pixels = len(np.unique(captures.pixel, axis=0))
    return f"the {pixels} panel pixels that were decoded lie on one line: decode pixels all over the panel"


DISPLAY: Side[DisplayCaptures, FittedDisplay] = Side(
    "display",
    "pixel",
    {
        "planar": ModelKind(_readings, _model),
        "volumetric": ModelKind(_readings, _model, VIEWPOINT),
        "static": ModelKind(_readings, _model, NOWHERE),
        "point-per-pixel": ModelKind(_of_points, _points),
        "grey-box": ModelKind(_readings, _model, needs_trend=True),
        "prescription": ModelKind(_readings, _model, needs_trend=True, is_trend_alone=True),
    },
    DISPLAY_LIMITS,
    lambda captures, kind, place: None,
    _lacking,
)
fit_display = DISPLAY.fit
"""Fit a display model; a trend is (u px, v px, x m, y m) -> (tx, ty) on the base plane."""
