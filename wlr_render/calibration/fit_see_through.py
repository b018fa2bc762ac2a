"""Fit a see-through model to captures."""

from collections.abc import Callable

import numpy as np

from wlr_render.calibration.base_plane import choose_base_plane
from wlr_render.calibration.coverage import missing_coverage
from wlr_render.calibration.fit_report import FitReport
from wlr_render.calibration.regression import Fitted, Regression, angular_metric, fit, relative_sigma
from wlr_render.captures.correspondences import SeeThroughCaptures, select
from wlr_render.errors import BadInputError
from wlr_render.geometry.planes import BasePlane
from wlr_render.mappings import SeeThroughMapping
from wlr_render.models.bundle import BundleSeeThrough
from wlr_render.models.contraction import require_unique
from wlr_render.models.fitted_model import FittedSeeThrough
from wlr_render.models.static import StaticSeeThrough
from wlr_render.models.volumetric import VolumetricSeeThrough
from wlr_render.numerics.arrays import BoolArray, FloatArray, IntArray
from wlr_render.numerics.least_squares import RankDeficientError

_SeeThroughFit = tuple[FittedSeeThrough, SeeThroughCaptures, dict[str, Fitted]]
"""A fitted mapping, the captures it was made from, and its fits by polynomial name."""


def fit_see_through(
    captures: SeeThroughCaptures, kind: str = "planar", degree: int | None = None, base_plane: BasePlane | None = None
) -> tuple[SeeThroughMapping, FitReport]:
    """Fit a see-through model to captures of targets.

    The model is the deviation from the straight ray. A point X seen at depth Z in front of the base plane along t
    gives (X_xy - p~) / Z - t = A + B / Z, which is linear in the unknown A(p~, t) and B(p~, t): any number of target
    poses, tilted or not, go into one least-squares problem that minimises angles, weighted by 1 / sigma.

    Args:
        captures: what was measured.
        kind: "planar", "volumetric" or "static" (of each target pose, only the camera position nearest to the eye
            box's centre is used).
        degree: total degree N, or None to choose it by held-out camera positions.
        base_plane: of a planar model; None for the plane of `choose_base_plane`.

    Raises:
        BadInputError: an unknown kind, a point behind the base plane, captures that do not determine the model, or a
            model that may have two solutions; the sentence says what is missing.
    """
    mapping, used, fits = _fitted(captures, kind, degree, base_plane)
    contraction = require_unique(mapping.contraction(), kind, "see-through")
    seen = mapping.view_dir_of_real_point(used.point, used.viewpoint)
    return mapping, FitReport.of(kind, used, fits, contraction, seen)


def see_through_of_degree(captures: SeeThroughCaptures, kind: str, degree: int) -> SeeThroughMapping:
    """Fit a see-through model of a given degree as `fit_see_through` does, without cross-validation and report."""
    return _fitted(captures, kind, degree)[0]


def _fitted(
    captures: SeeThroughCaptures, kind: str, degree: int | None, base_plane: BasePlane | None = None
) -> _SeeThroughFit:
    if kind not in _KINDS:
        raise BadInputError(f"the kind of see-through model '{kind}' is unknown; choose one of {', '.join(_KINDS)}.")
    plane = base_plane or choose_base_plane(captures.viewpoint, captures.eye_box)
    if np.any(plane.depth_of(captures.point) <= 0):
        raise BadInputError(
            f"the base plane, z = {plane.z:g} m, lies beyond some target points; correct the eye box or the base plane."
        )
    refusal = f"the captures do not determine a {kind} see-through model"
    lowest = 1 if degree is None else degree
    # Positions that are not exact, and a target that is tilted, hide from the rank that they are too few.
    if lacks := _lacking_places(captures, kind, lowest):
        raise BadInputError(f"{refusal}: {lacks}.")
    try:
        return _KINDS[kind](captures, plane, degree)
    except RankDeficientError as error:
        lacks = missing_coverage("view directions", captures.tangents, "xy", lowest)
        raise BadInputError(f"{refusal}: {lacks or _one_depth(captures)}.") from error


def _fit_planar(captures: SeeThroughCaptures, plane: BasePlane, degree: int | None) -> _SeeThroughFit:
    tangents = captures.tangents
    in_plane = plane.carry(captures.viewpoint, tangents)
    depth = (plane.z_at(in_plane) - captures.point[:, 2])[:, None]
    observed = (captures.point[:, :2] - in_plane) / depth - tangents
    fitted = _deviation(captures, np.hstack([in_plane, tangents]), observed, depth, captures.capture, degree)
    return BundleSeeThrough(captures.eye_box, plane, fitted.polynomial), captures, {"deviation": fitted}


def _fit_volumetric(captures: SeeThroughCaptures, _: BasePlane, degree: int | None) -> _SeeThroughFit:
    forward = _forward(captures, captures.viewpoint, captures.capture, degree)
    return VolumetricSeeThrough(captures.eye_box, forward.polynomial), captures, {"forward": forward}


def _fit_static(captures: SeeThroughCaptures, _: BasePlane, degree: int | None) -> _SeeThroughFit:
    centred = select(captures, _nominal(captures))
    forward = _forward(centred, np.empty((len(centred), 0)), np.arange(len(centred)), degree)
    return StaticSeeThrough(captures.eye_box, forward.polynomial), centred, {"forward": forward}


_KINDS: dict[str, Callable[[SeeThroughCaptures, BasePlane, int | None], _SeeThroughFit]] = {
    "planar": _fit_planar,
    "volumetric": _fit_volumetric,
    "static": _fit_static,
}


def _forward(captures: SeeThroughCaptures, position: FloatArray, group: IntArray, degree: int | None) -> Fitted:
    """Deviation of models without a base plane; `position` (n, any) is what they know of it."""
    tangents = captures.tangents
    depth = captures.viewpoint[:, 2:] - captures.point[:, 2:]
    straight = (captures.point[:, :2] - captures.viewpoint[:, :2]) / depth
    return _deviation(captures, np.hstack([position, tangents]), straight - tangents, depth, group, degree)


def _deviation(
    captures: SeeThroughCaptures,
    inputs: FloatArray,
    observed: FloatArray,
    depth: FloatArray,
    group: IntArray,
    degree: int | None,
) -> Fitted:
    """Fit observed (n, 2) = A(inputs) + B(inputs) / depth."""
    multiplier = np.stack([np.ones_like(depth), 1.0 / depth], axis=2)
    metric = angular_metric(captures.tangents)
    sigma = relative_sigma(captures.sigma_arcmin)
    return fit(Regression(inputs, observed[:, None], multiplier, metric, sigma, group), degree)


def _nominal(captures: SeeThroughCaptures) -> BoolArray:
    """Rows (n,) of each target pose's camera position nearest to the eye box's centre."""
    distance = np.linalg.norm(captures.viewpoint - captures.eye_box.centre, axis=1)
    chosen = np.zeros(len(captures), dtype=bool)
    for pose in np.unique(captures.target_pose):
        rows = np.flatnonzero(captures.target_pose == pose)
        nearest = captures.capture[rows[np.argmin(distance[rows])]]
        chosen[rows] = captures.capture[rows] == nearest
    return chosen


def _lacking_places(captures: SeeThroughCaptures, kind: str, degree: int) -> str | None:
    lacks = None
    if kind == "planar":
        lacks = missing_coverage("viewpoints", captures.viewpoint[:, :2], "xy", degree)
    elif kind == "volumetric":
        lacks = missing_coverage("viewpoints", captures.viewpoint, "xyz", degree)
    if lacks is None and len(np.unique(captures.target_pose)) < 2:
        lacks = _one_depth(captures)
    return lacks


def _one_depth(captures: SeeThroughCaptures) -> str:
    poses = len(np.unique(captures.target_pose))
    return f"it needs a second target depth and there are {poses} target pose(s): add one nearer or farther"
