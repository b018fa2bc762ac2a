"""Fit a display model to captures."""

import numpy as np

from wlr_render.calibration.fit_report import ModelFit
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
from wlr_render.calibration.smooth_prior import Stage
from wlr_render.captures.correspondences import DisplayCaptures
from wlr_render.geometry.planes import BasePlane
from wlr_render.models.display_model import DisplayModel
from wlr_render.models.fitted_model import FittedDisplay
from wlr_render.models.inverse import backward_start_of
from wlr_render.models.model_place import NOWHERE, VIEWPOINT, ModelPlace
from wlr_render.models.point_per_pixel import PointPerPixelDisplay
from wlr_render.models.spread import Covariance
from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.regressor import Regressor

DISPLAY_LIMITS = (Limits(8, 5, 8), Limits(10, 5, 10), Limits(pixel=12, place=6, total=12))
"""Of the first fit, and of all fits; the terms between them are used as far as they matter."""


def fit_display(
    captures: DisplayCaptures,
    kind: str = "planar",
    degree: int | None = None,
    base_plane: BasePlane | None = None,
    trend: Trend | None = None,
    weights: FloatArray | None = None,
    stage: Stage | None = None,
) -> ModelFit[FittedDisplay]:
    """Fit a display model to captures of the panel by maximum evidence.

    Args:
        captures: what was measured.
        kind: "planar" (viewpoints are carried along their measured rays to the base plane), "volumetric",
            "static" (only the camera position nearest to the eye box's centre is used), "point-per-pixel", or with a
            trend "grey-box" (planar, and the trend is its prior mean) or "prescription" (the trend alone).
        degree: highest total degree; None for the terms within `DISPLAY_LIMITS` that matter.
        base_plane: of a planar model; None for the plane of `choose_base_plane`.
        trend: (u px, v px, x m, y m) -> (tx, ty) on that plane; of a grey box or prescription.
        weights: (n,) of the captures' readings, see `smooth_search.fit`.
        stage: what other captures of the bench tell of the stage's errors; None to find them.

    Raises:
        BadInputError: an unknown kind, captures that determine nothing or contradict each other, or a model that may
            have two solutions; the sentence says what is missing.
    """
    return DISPLAY.fit(captures, kind, degree, base_plane, trend, weights, stage)


def _readings(captures: DisplayCaptures, place: ModelPlace, limits: Limits, trend: Trend | None) -> FitReadings:
    tangents, places = captures.tangents, place.coordinates
    carried = place.carry_by_tangents(place.depth_along(captures.viewpoint, tangents), tangents)
    at_place = place.carry(captures.viewpoint, tangents)

    def respond(slope: FloatArray, turned: FloatArray, rows: slice) -> FloatArray:
        """Return the change of t - f(pixel, place), which moves with the camera and the direction of carrying."""
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
    """Return readings of t = a - w q, linear in the unknown a and w.

    q, where the measured ray meets the nominal plane, is known.
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
    captures: DisplayCaptures, place: ModelPlace, forward: Regressor, spread: Covariance | None
) -> FittedDisplay:
    return DisplayModel(captures.panel, captures.eye_box, place, forward, backward_start_of(forward), spread)


def _points(captures: DisplayCaptures, _: ModelPlace, point: Regressor, spread: Covariance | None) -> FittedDisplay:
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
        "static": ModelKind(_readings, _model, NOWHERE, has_places=False, at_one_position=True),
        "point-per-pixel": ModelKind(_of_points, _points, has_places=False),
        "grey-box": ModelKind(_readings, _model, needs_trend=True),
        "prescription": ModelKind(_readings, _model, needs_trend=True, is_trend_alone=True),
    },
    DISPLAY_LIMITS,
    lambda captures, kind, plane: None,
    _lacking,
)
