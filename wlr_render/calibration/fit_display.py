"""Fit a display model to captures."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from wlr_render.calibration.coverage import missing_coverage
from wlr_render.calibration.fit_report import FitReport, Residuals
from wlr_render.calibration.regression import Fitted, Regression, angular_metric, fit, relative_sigma
from wlr_render.captures.correspondences import DisplayCaptures, select
from wlr_render.errors import BadInputError
from wlr_render.geometry.directions import arcmin_between
from wlr_render.geometry.planes import BasePlane
from wlr_render.mappings import DisplayMapping
from wlr_render.models.bundle import BundleDisplay
from wlr_render.models.point_per_pixel import PointPerPixelDisplay
from wlr_render.models.static import StaticDisplay
from wlr_render.models.volumetric import VolumetricDisplay
from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.least_squares import RankDeficientError


@dataclass(frozen=True)
class _DisplayFit:
    """A fitted mapping, the captures it was made from, and its fits by polynomial name; the forward one is first."""

    mapping: DisplayMapping
    captures: DisplayCaptures
    fits: dict[str, Fitted]


def fit_display(
    captures: DisplayCaptures, kind: str = "planar", degree: int | None = None, base_plane: BasePlane | None = None
) -> tuple[DisplayMapping, FitReport]:
    """Fit a display model to captures of the panel.

    The forward polynomials minimise angles, the backward ones pixels, both weighted by 1 / sigma.

    Args:
        captures: what was measured.
        kind: "planar", "volumetric", "static" (only the camera position nearest to the eye box's centre is used) or
            "point-per-pixel".
        degree: total degree N, or None to choose it by held-out camera positions.
        base_plane: for "planar"; None for the plane through the eye box's centre. Viewpoints off the plane are carried
            to it along their measured rays.

    Raises:
        BadInputError: an unknown kind, or captures that do not determine the model; the sentence says what is missing.
    """
    result = _fitted(captures, kind, degree, base_plane)
    return result.mapping, _report(kind, result)


def display_of_degree(captures: DisplayCaptures, kind: str, degree: int) -> DisplayMapping:
    """Fit a display model of a given degree as `fit_display` does, without cross-validation and report."""
    return _fitted(captures, kind, degree, None).mapping


def _fitted(captures: DisplayCaptures, kind: str, degree: int | None, base_plane: BasePlane | None) -> _DisplayFit:
    if kind not in _KINDS:
        raise BadInputError(f"the kind of display model '{kind}' is unknown; choose one of {', '.join(_KINDS)}.")
    plane = base_plane or BasePlane(float(captures.eye_box.centre[2]))
    refusal = f"the captures do not determine a {kind} display model"
    lowest = 1 if degree is None else degree
    # Positions that are not exact hide from the rank that they are too few.
    if lacks := _lacking_viewpoints(captures, kind, lowest):
        raise BadInputError(f"{refusal}: {lacks}.")
    try:
        return _KINDS[kind](captures, plane, degree)
    except RankDeficientError as error:
        lacks = missing_coverage("panel pixels", captures.pixel, "uv", lowest)
        reason = lacks or "pixels and viewpoints are not spread independently of each other"
        raise BadInputError(f"{refusal}: {reason}.") from error


def _fit_planar(captures: DisplayCaptures, plane: BasePlane, degree: int | None) -> _DisplayFit:
    tangents = captures.tangents
    in_plane = plane.carry(captures.viewpoint, tangents)
    forward = _forward(captures, np.hstack([captures.pixel, in_plane]), degree)
    backward = _backward(captures, np.hstack([in_plane, tangents]), forward)
    mapping = BundleDisplay(captures.panel, captures.eye_box, plane, forward.polynomial, backward.polynomial)
    return _DisplayFit(mapping, captures, {"forward": forward, "backward": backward})


def _fit_volumetric(captures: DisplayCaptures, _: BasePlane, degree: int | None) -> _DisplayFit:
    forward = _forward(captures, np.hstack([captures.pixel, captures.viewpoint]), degree)
    backward = _backward(captures, np.hstack([captures.viewpoint, captures.tangents]), forward)
    mapping = VolumetricDisplay(captures.panel, captures.eye_box, forward.polynomial, backward.polynomial)
    return _DisplayFit(mapping, captures, {"forward": forward, "backward": backward})


def _fit_static(captures: DisplayCaptures, _: BasePlane, degree: int | None) -> _DisplayFit:
    centred = _nominal(captures)
    forward = _forward(centred, centred.pixel, degree, by_position=False)
    backward = _backward(centred, centred.tangents, forward, by_position=False)
    mapping = StaticDisplay(captures.panel, captures.eye_box, forward.polynomial, backward.polynomial)
    return _DisplayFit(mapping, centred, {"forward": forward, "backward": backward})


def _fit_point_per_pixel(captures: DisplayCaptures, _: BasePlane, degree: int | None) -> _DisplayFit:
    """t = a - w q is linear in the unknown a and w: q, where the measured ray meets the nominal plane, is known."""
    tangents = captures.tangents
    centre = captures.eye_box.centre
    crossing = BasePlane(float(centre[2])).carry(captures.viewpoint, tangents) - centre[:2]
    multiplier = np.zeros((len(captures), 2, 3))
    multiplier[:, 0, 0] = multiplier[:, 1, 1] = 1.0
    multiplier[:, :, 2] = -crossing
    point = fit(
        Regression(
            captures.pixel,
            tangents[:, :, None],
            multiplier,
            angular_metric(tangents),
            relative_sigma(captures.sigma_arcmin),
            captures.capture,
        ),
        degree,
    )
    return _DisplayFit(
        PointPerPixelDisplay(captures.panel, captures.eye_box, point.polynomial), captures, {"point": point}
    )


_KINDS: dict[str, Callable[[DisplayCaptures, BasePlane, int | None], _DisplayFit]] = {
    "planar": _fit_planar,
    "volumetric": _fit_volumetric,
    "static": _fit_static,
    "point-per-pixel": _fit_point_per_pixel,
}


def _nominal(captures: DisplayCaptures) -> DisplayCaptures:
    """The captures of the camera position nearest to the eye box's centre."""
    distance = np.linalg.norm(captures.viewpoint - captures.eye_box.centre, axis=1)
    return select(captures, captures.capture == captures.capture[np.argmin(distance)])


def _forward(captures: DisplayCaptures, inputs: FloatArray, degree: int | None, by_position: bool = True) -> Fitted:
    tangents = captures.tangents
    sigma, group = relative_sigma(captures.sigma_arcmin), captures.capture if by_position else np.arange(len(captures))
    return fit(Regression.plain(inputs, tangents, angular_metric(tangents), sigma, group), degree)


def _backward(captures: DisplayCaptures, inputs: FloatArray, forward: Fitted, by_position: bool = True) -> Fitted:
    """At the degree of the forward fit."""
    sigma, group = relative_sigma(captures.sigma_arcmin), captures.capture if by_position else np.arange(len(captures))
    regression = Regression.plain(inputs, captures.pixel, np.ones(len(captures)), sigma, group)
    return fit(regression, forward.polynomial.degree)


def _lacking_viewpoints(captures: DisplayCaptures, kind: str, degree: int) -> str | None:
    if kind == "planar":
        return missing_coverage("viewpoints", captures.viewpoint[:, :2], "xy", degree)
    if kind == "volumetric":
        return missing_coverage("viewpoints", captures.viewpoint, "xyz", degree)
    if kind == "point-per-pixel" and len(np.unique(captures.viewpoint, axis=0)) == 1:
        return "a point's distance needs at least 2 viewpoints and there is 1: 1 more"
    return None


def _report(kind: str, result: _DisplayFit) -> FitReport:
    captures, fits = result.captures, list(result.fits.values())
    seen = result.mapping.view_dir_of_pixel(captures.pixel, captures.viewpoint)
    shown = result.mapping.pixel_of_view_dir(captures.view_dir, captures.viewpoint)
    held_out_px = fits[1].held_out if len(fits) > 1 else ()
    return FitReport(
        kind=kind,
        degree=fits[0].polynomial.degree,
        coefficients={name: fitted.polynomial.coefficients.size for name, fitted in result.fits.items()},
        condition=max(fitted.condition for fitted in fits),
        viewpoints=len(np.unique(captures.capture)),
        samples=len(captures),
        unsolved=int(np.sum(~(seen.usable & shown.usable))),
        residual_arcmin=Residuals.of(arcmin_between(seen.value, captures.view_dir)),
        residual_px=Residuals.of(np.linalg.norm(shown.value - captures.pixel, axis=1)),
        held_out_arcmin=fits[0].held_out,
        held_out_px=held_out_px[0] if held_out_px else None,
    )
