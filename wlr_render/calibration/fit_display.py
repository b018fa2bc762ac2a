"""Fit a display model to captures."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from wlr_render.calibration.base_plane import choose_base_plane
from wlr_render.calibration.fit_report import ModelFit
from wlr_render.calibration.readings import (
    TREND_ALONE,
    Limits,
    Readings,
    Trend,
    UndeterminedError,
    angular_metric,
    turn_columns,
)
from wlr_render.calibration.smooth_fit import fit_within
from wlr_render.calibration.smooth_prior import Stage
from wlr_render.captures.correspondences import DisplayCaptures, select
from wlr_render.errors import BadInputError
from wlr_render.geometry.planes import BasePlane
from wlr_render.models.bundle import BundleDisplay
from wlr_render.models.contraction import require_unique
from wlr_render.models.fitted_model import FittedDisplay
from wlr_render.models.inverse import backward_start_of
from wlr_render.models.point_per_pixel import PointPerPixelDisplay
from wlr_render.models.spread import Spread
from wlr_render.models.static import StaticDisplay
from wlr_render.models.volumetric import VolumetricDisplay
from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.polynomial import Box, Polynomial

DISPLAY_LIMITS = (Limits(pixel=8, place=5, total=8), Limits(pixel=10, place=5, total=10))
"""What the optics of the shipped devices need at usual noise, and without noise; the evidence decides how much of it
is used."""


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
        degree: highest total degree; None for `DISPLAY_LIMITS`.
        base_plane: of a planar model; None for the plane of `choose_base_plane`.
        trend: (u px, v px, x m, y m) -> (tx, ty) on that plane; of a grey box or prescription.
        weights: (n,) of the captures' readings, see `smooth_fit.fit`.
        stage: repeatability and wobble; None to find them.

    Raises:
        BadInputError: an unknown kind, captures that determine nothing or contradict each other, or a model that may
            have two solutions; the sentence says what is missing.
    """
    if kind not in _KINDS:
        raise BadInputError(f"the kind of display model '{kind}' is unknown; choose one of {', '.join(_KINDS)}.")
    how = _KINDS[kind]
    if how.needs_trend and trend is None:
        raise BadInputError(f"a {kind} display model needs the device's prescription; name it, or fit a planar model.")
    used = _nearest_to_centre(captures) if how.nominal else captures
    plane = base_plane or choose_base_plane(used.viewpoint, used.eye_box)
    limits = DISPLAY_LIMITS if degree is None else (Limits(degree, degree, degree),)
    if how.nothing_but_trend:
        limits = (TREND_ALONE,)
    readings_within = partial(how.readings, plane=plane, trend=trend if how.needs_trend else None)
    try:
        smooth = fit_within(lambda limits: readings_within(used, limits=limits), limits, weights, stage)
    except UndeterminedError as error:
        raise BadInputError(f"the captures do not determine a {kind} display model: {_lacking(used, kind)}.") from error
    if degree is None:  # a limit may be why no polynomial follows
        smooth.require_agreement(f"the display captures of {captures.device}", used.sigma_arcmin)
    used_limits = smooth.readings.limits
    readings_of = partial(readings_within, limits=used_limits)
    mapping = how.model(used, plane, smooth.polynomial, smooth.spread)
    contraction = require_unique(mapping.contraction(), kind, "display")
    return ModelFit(kind, mapping, used, smooth, readings_of, used_limits.words("pixel", how.places), contraction)


def planar_box(captures: DisplayCaptures, plane: BasePlane) -> Box:
    """Box (u px, v px, x m, y m) of a planar fit, for which its trend is compiled."""
    return _on_plane(captures, plane, TREND_ALONE, None).box


def with_trend(fitted: ModelFit[FittedDisplay], trend: Trend) -> ModelFit[FittedDisplay]:
    """The fit with another prior of the trend's parameters; see `SmoothFit.with_trend`."""
    smooth = fitted.smooth.with_trend(trend)
    assert isinstance(fitted.mapping, BundleDisplay)
    mapping = replace(
        fitted.mapping,
        forward=smooth.polynomial,
        backward_start=backward_start_of(smooth.polynomial),
        spread=smooth.spread,
    )
    return replace(fitted, mapping=mapping, smooth=smooth, readings_of=partial(fitted.readings_of, trend=trend))


def _on_plane(captures: DisplayCaptures, plane: BasePlane, limits: Limits, trend: Trend | None) -> Readings:
    tangents = captures.tangents
    depth = plane.depth_along(captures.viewpoint, tangents)
    carried = plane.carry_by_tangents(depth, tangents)
    in_plane = captures.viewpoint[:, :2] + depth[:, None] * tangents

    def motion(slope: FloatArray) -> FloatArray:
        """t - f(pixel, p~): p~ moves with the camera, and with the direction that it is carried along."""
        by_place, turned = slope[:, :, 2:], turn_columns(tangents)
        along_z = tangents / (1.0 + tangents @ np.array(plane.slope))[:, None]
        shifted = np.concatenate([_shift_in_plane(plane, along_z), along_z[:, :, None]], axis=2)
        return np.concatenate([-by_place @ shifted, turned - by_place @ carried @ turned], axis=2)

    return _readings(captures, in_plane, motion, limits, trend)


def _shift_in_plane(plane: BasePlane, along_z: FloatArray) -> FloatArray:
    """Derivative (n, 2, 2) of p~ by x and y of the viewpoint."""
    return np.asarray(np.eye(2) - along_z[:, :, None] * np.array(plane.slope))


def _in_volume(captures: DisplayCaptures, plane: BasePlane, limits: Limits, trend: Trend | None) -> Readings:
    tangents = captures.tangents

    def motion(slope: FloatArray) -> FloatArray:
        return np.concatenate([-slope[:, :, 2:], turn_columns(tangents)], axis=2)

    return _readings(captures, captures.viewpoint, motion, limits, trend)


def _at_one_place(captures: DisplayCaptures, plane: BasePlane, limits: Limits, trend: Trend | None) -> Readings:
    return _readings(captures, np.empty((len(captures), 0)), None, limits, trend)


def _readings(
    captures: DisplayCaptures,
    place: FloatArray,
    motion: Callable[[FloatArray], FloatArray] | None,
    limits: Limits,
    trend: Trend | None,
) -> Readings:
    tangents = captures.tangents
    places = place.shape[1]
    return Readings(
        inputs=np.hstack([captures.pixel, place]),
        is_place=np.array([False, False] + [True] * places),
        observed=tangents,
        multiplier=np.ones((len(captures), 1)),
        metric=angular_metric(tangents),
        sigma=captures.sigma_arcmin,
        capture=np.unique(captures.capture, return_inverse=True)[1],
        motion=motion,
        orders=limits.orders(2, places),
        limits=limits,
        trend=trend,
    )


def _of_points(captures: DisplayCaptures, plane: BasePlane, limits: Limits, trend: Trend | None) -> Readings:
    """t = a - w q is linear in the unknown a and w: q, where the measured ray meets the nominal plane, is known."""
    tangents, centre = captures.tangents, captures.eye_box.centre
    crossing = BasePlane(float(centre[2])).carry(captures.viewpoint, tangents) - centre[:2]
    multiplier = np.zeros((len(captures), 2, 3))
    multiplier[:, 0, 0] = multiplier[:, 1, 1] = 1.0
    multiplier[:, :, 2] = -crossing
    return Readings(
        inputs=captures.pixel,
        is_place=np.array([False, False]),
        observed=tangents,
        multiplier=multiplier,
        metric=angular_metric(tangents),
        sigma=captures.sigma_arcmin,
        capture=np.unique(captures.capture, return_inverse=True)[1],
        motion=None,
        orders=limits.orders(2, 0),
        limits=limits,
    )


def _bundle(captures: DisplayCaptures, plane: BasePlane, forward: Polynomial, spread: Spread) -> FittedDisplay:
    return BundleDisplay(captures.panel, captures.eye_box, plane, forward, backward_start_of(forward), spread)


def _volumetric(captures: DisplayCaptures, _: BasePlane, forward: Polynomial, spread: Spread) -> FittedDisplay:
    return VolumetricDisplay(captures.panel, captures.eye_box, forward, backward_start_of(forward), spread)


def _static(captures: DisplayCaptures, _: BasePlane, forward: Polynomial, spread: Spread) -> FittedDisplay:
    return StaticDisplay(captures.panel, captures.eye_box, forward, backward_start_of(forward), spread)


def _points(captures: DisplayCaptures, _: BasePlane, point: Polynomial, spread: Spread) -> FittedDisplay:
    return PointPerPixelDisplay(captures.panel, captures.eye_box, point, spread)


@dataclass(frozen=True)
class _Kind:
    """How a kind of model is fitted.

    Attributes:
        readings: (captures, plane, limits, trend) -> readings.
        model: (captures, plane, polynomial, spread) -> model.
        places: whether it depends on the place. nominal: whether it is fitted at one camera position only.
        needs_trend: whether it has a trend. nothing_but_trend: and nothing else.
    """

    readings: Callable[..., Readings]
    model: Callable[[DisplayCaptures, BasePlane, Polynomial, Spread], FittedDisplay]
    places: bool = True
    nominal: bool = False
    needs_trend: bool = False
    nothing_but_trend: bool = False


_KINDS = {
    "planar": _Kind(_on_plane, _bundle),
    "volumetric": _Kind(_in_volume, _volumetric),
    "static": _Kind(_at_one_place, _static, places=False, nominal=True),
    "point-per-pixel": _Kind(_of_points, _points, places=False),
    "grey-box": _Kind(_on_plane, _bundle, needs_trend=True),
    "prescription": _Kind(_on_plane, _bundle, needs_trend=True, nothing_but_trend=True),
}


def _nearest_to_centre(captures: DisplayCaptures) -> DisplayCaptures:
    distance = np.linalg.norm(captures.viewpoint - captures.eye_box.centre, axis=1)
    return select(captures, captures.capture == captures.capture[np.argmin(distance)])


def _lacking(captures: DisplayCaptures, kind: str) -> str:
    places = len(np.unique(captures.viewpoint, axis=0))
    if kind == "point-per-pixel" and places < 2:
        return f"a point in space needs two camera positions at least and there is {places}: add one beside it"
    pixels = len(np.unique(captures.pixel, axis=0))
    return f"the {pixels} panel pixels that were decoded lie on one line: decode pixels all over the panel"
