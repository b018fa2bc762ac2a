"""Fit a display model to captures."""

from collections.abc import Callable

import numpy as np

from wlr_render.calibration.base_plane import choose_base_plane
from wlr_render.calibration.coverage import missing_coverage
from wlr_render.calibration.fit_report import FitReport
from wlr_render.calibration.regression import Fitted, Regression, angular_metric, fit, relative_sigma
from wlr_render.captures.correspondences import DisplayCaptures, select
from wlr_render.errors import BadInputError
from wlr_render.geometry.planes import BasePlane
from wlr_render.mappings import DisplayMapping
from wlr_render.models.bundle import BundleDisplay
from wlr_render.models.contraction import require_unique
from wlr_render.models.fitted_model import FittedDisplay
from wlr_render.models.inverse import backward_start_of
from wlr_render.models.point_per_pixel import PointPerPixelDisplay
from wlr_render.models.static import StaticDisplay
from wlr_render.models.volumetric import VolumetricDisplay
from wlr_render.numerics.arrays import FloatArray, IntArray
from wlr_render.numerics.least_squares import RankDeficientError

_DisplayFit = tuple[FittedDisplay, DisplayCaptures, dict[str, Fitted]]
"""A fitted mapping, the captures it was made from, and its fits by polynomial name."""


def fit_display(
    captures: DisplayCaptures, kind: str = "planar", degree: int | None = None, base_plane: BasePlane | None = None
) -> tuple[DisplayMapping, FitReport]:
    """Fit a display model to captures of the panel.

    The forward polynomials minimise angles, weighted by 1 / sigma; backward queries solve them.

    Args:
        captures: what was measured.
        kind: "planar" (viewpoints are carried along their measured rays to the base plane), "volumetric",
            "static" (only the camera position nearest to the eye box's centre is used) or "point-per-pixel".
        degree: total degree N, or None to choose it by held-out camera positions.
        base_plane: of a planar model; None for the plane of `choose_base_plane`.

    Raises:
        BadInputError: an unknown kind, or captures that do not determine the model, or a model
            that may have two solutions; the sentence says what is missing.
    """
    mapping, used, fits = _fitted(captures, kind, degree, base_plane)
    contraction = require_unique(mapping.contraction(), kind, "display")
    seen = mapping.view_dir_of_pixel(used.pixel, used.viewpoint)
    shown = mapping.pixel_of_view_dir(used.view_dir, used.viewpoint)
    return mapping, FitReport.of(kind, used, fits, contraction, seen, shown)


def display_of_degree(captures: DisplayCaptures, kind: str, degree: int) -> DisplayMapping:
    """Fit a display model of a given degree as `fit_display` does, without cross-validation and report."""
    return _fitted(captures, kind, degree)[0]


def _fitted(
    captures: DisplayCaptures, kind: str, degree: int | None, base_plane: BasePlane | None = None
) -> _DisplayFit:
    if kind not in _KINDS:
        raise BadInputError(f"the kind of display model '{kind}' is unknown; choose one of {', '.join(_KINDS)}.")
    refusal = f"the captures do not determine a {kind} display model"
    lowest = 1 if degree is None else degree
    # Positions that are not exact hide from the rank that they are too few.
    if lacks := _lacking_viewpoints(captures, kind, lowest):
        raise BadInputError(f"{refusal}: {lacks}.")
    try:
        return _KINDS[kind](captures, base_plane or choose_base_plane(captures.viewpoint, captures.eye_box), degree)
    except RankDeficientError as error:
        lacks = missing_coverage("panel pixels", captures.pixel, "uv", lowest)
        reason = lacks or "pixels and viewpoints are not spread independently of each other"
        raise BadInputError(f"{refusal}: {reason}.") from error


def _fit_planar(captures: DisplayCaptures, plane: BasePlane, degree: int | None) -> _DisplayFit:
    in_plane = plane.carry(captures.viewpoint, captures.tangents)
    forward = _forward(captures, in_plane, captures.capture, degree)
    start = backward_start_of(forward.polynomial)
    mapping = BundleDisplay(captures.panel, captures.eye_box, plane, forward.polynomial, start)
    return mapping, captures, {"forward": forward}


def _fit_volumetric(captures: DisplayCaptures, _: BasePlane, degree: int | None) -> _DisplayFit:
    forward = _forward(captures, captures.viewpoint, captures.capture, degree)
    start = backward_start_of(forward.polynomial)
    mapping = VolumetricDisplay(captures.panel, captures.eye_box, forward.polynomial, start)
    return mapping, captures, {"forward": forward}


def _fit_static(captures: DisplayCaptures, _: BasePlane, degree: int | None) -> _DisplayFit:
    distance = np.linalg.norm(captures.viewpoint - captures.eye_box.centre, axis=1)
    centred = select(captures, captures.capture == captures.capture[np.argmin(distance)])
    forward = _forward(centred, np.empty((len(centred), 0)), np.arange(len(centred)), degree)
    start = backward_start_of(forward.polynomial)
    mapping = StaticDisplay(captures.panel, captures.eye_box, forward.polynomial, start)
    return mapping, centred, {"forward": forward}


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
    mapping = PointPerPixelDisplay(captures.panel, captures.eye_box, point.polynomial)
    return mapping, captures, {"point": point}


_KINDS: dict[str, Callable[[DisplayCaptures, BasePlane, int | None], _DisplayFit]] = {
    "planar": _fit_planar,
    "volumetric": _fit_volumetric,
    "static": _fit_static,
    "point-per-pixel": _fit_point_per_pixel,
}


def _forward(captures: DisplayCaptures, position: FloatArray, group: IntArray, degree: int | None) -> Fitted:
    """Fit from pixel and `position` (n, any)."""
    tangents, sigma = captures.tangents, relative_sigma(captures.sigma_arcmin)
    inputs = np.hstack([captures.pixel, position])
    return fit(Regression.plain(inputs, tangents, angular_metric(tangents), sigma, group), degree)


def _lacking_viewpoints(captures: DisplayCaptures, kind: str, degree: int) -> str | None:
    if kind == "planar":
        return missing_coverage("viewpoints", captures.viewpoint[:, :2], "xy", degree)
    if kind == "volumetric":
        return missing_coverage("viewpoints", captures.viewpoint, "xyz", degree)
    if kind == "point-per-pixel" and len(np.unique(captures.viewpoint, axis=0)) == 1:
        return "a point's distance needs at least 2 viewpoints and there is 1: 1 more"
    return None
