"""Every method on photographs of a target through a headset; each view is predicted by the others."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from benchmarks.published_data.itoh_seethrough import SeeThroughPairs, see_through_session
from benchmarks.rivals.held_out import COLUMNS, HeldOut, cells, held_out, rms_of
from benchmarks.rivals.kernels import free_kernel_ridge, gaussian_process, kernel_ridge
from benchmarks.rivals.map_tables import linear_table, principal_components, thin_plate_table
from benchmarks.rivals.plane_and_polynomial import wientapper_see_through
from benchmarks.rivals.samples import Fit, fit_structure
from wlr_render.bench.bench import Bench
from wlr_render.bench.session_captures import see_through_captures
from wlr_render.calibration.fit_see_through import SEE_THROUGH, fit_see_through
from wlr_render.captures.correspondences import SeeThroughCaptures, select
from wlr_render.captures.session import Session
from wlr_render.diagnosis.causes.user_causes import causes_for
from wlr_render.diagnosis.held_out import held_out_residual
from wlr_render.diagnosis.observations import SEE_THROUGH as SEE_THROUGH_PART
from wlr_render.diagnosis.procedure import diagnose
from wlr_render.errors import BadInputError
from wlr_render.geometry.directions import ARCMIN, dir_of_tangents, normalised
from wlr_render.mappings import EyeBox, SeeThroughMapping
from wlr_render.numerics.arrays import BoolArray, FloatArray
from wlr_render.report.blocks import Cell, ReportTable

REFERENCE = "plate and wedge"
STRUCTURES = ("static", "volumetric", "planar")
_CAUSE = "see_through_plate"
_DEGREES = (1, 2, 3)

FitView = Callable[[SeeThroughCaptures], SeeThroughMapping]


def view_table(pairs: SeeThroughPairs) -> ReportTable:
    """Tabulate errors of all methods in views that were not fitted."""
    judged = judged_views(pairs)
    reference = next(each for each in judged if each.method == REFERENCE)
    rows: list[list[Cell]] = [[each.method, len(each.error), *cells(each, reference)] for each in judged]
    columns = ["method", "readings", *(each.format(REFERENCE) for each in COLUMNS)]
    views, dots = pairs.through_px.shape[:2]
    ours = min((each for each in judged if each.method.startswith("ours")), key=rms_of)
    notes = (
        f"{views} views of {dots} dots; each view is predicted by a fit to the others. Rms of the angle, both axes "
        "together. Intervals: bootstrap over the views.",
        "Readings that are far from the smooth pattern of their neighbours are neither fitted nor tested.",
        "Kernel ridge regression on the base plane is the method that these photographs were taken for.",
        f"Ours with the least error: {ours.method.removeprefix('ours: ')}.",
    )
    return ReportTable("See-through views that were not fitted", columns, rows, notes)


def judged_views(pairs: SeeThroughPairs) -> list[HeldOut]:
    """Return the errors of every method in left-out views, with the view as the group.

    Raises:
        BadInputError: the photographs show no plate to compare with.
    """
    bench, session = see_through_session(pairs)
    found = diagnose(bench, session, causes=causes_for(bench, only=(_CAUSE,)))
    if not found.causes:
        raise BadInputError("see-through views: the diagnosis finds no plate in front of the camera.")
    captures = _captures(bench, session, found.used)
    observations = found.readings.observations
    measured_px = observations.session.readings.dot_pixel
    assert measured_px is not None
    rest_px = held_out_residual(found.fit, observations) * observations.sigma_of(SEE_THROUGH_PART)
    seen, predicted = (
        dir_of_tangents(bench.camera.tangents_of_pixel(each)) for each in (measured_px, measured_px - rest_px)
    )
    straight = normalised(captures.point - captures.viewpoint)
    judged = [
        HeldOut("no model", _angle(straight, captures.view_dir), captures.capture),
        HeldOut(REFERENCE, _angle(predicted, seen), captures.capture),
    ]

    def error(fit: FitView, view: int) -> FloatArray:
        out = captures.capture == view
        tested = select(captures, out)
        seen = fit(select(captures, ~out)).view_dir_of_real_point(tested.point, tested.viewpoint).value
        return _angle(seen, tested.view_dir)

    return judged + [held_out(name, captures.capture, partial(error, fit)) for name, fit in _methods().items()]


def _angle(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return the angles in arcminutes between close unit vectors (n, 3)."""
    return np.asarray(np.linalg.norm(first - second, axis=1) / ARCMIN)


def _methods() -> dict[str, FitView]:
    found: dict[str, FitView] = {}
    for structure in STRUCTURES:
        for degree in _DEGREES:
            found[f"polynomial of degree {degree} by least squares, {structure}"] = _structured(
                structure, _polynomial(degree)
            )
    for name, regressor in _REGRESSORS.items():
        for structure in STRUCTURES:
            found[f"{name}, {structure}"] = _structured(structure, regressor)
    for name, regressor in _TABLES.items():
        found[f"{name}, planar"] = _structured("planar", regressor)
    found["polynomial of chosen degree (Wientapper)"] = lambda captures: wientapper_see_through(captures)[0]
    for structure in STRUCTURES:
        for each in (*_DEGREES, None):
            order = "chosen degree" if each is None else f"degree {each}"
            found[f"ours: {structure}, {order}"] = _ours(structure, each)
    return found


_REGRESSORS: dict[str, Fit] = {
    "kernel ridge as published": kernel_ridge,
    "kernel ridge freed": free_kernel_ridge,
    "Gaussian process": gaussian_process,
}
_TABLES: dict[str, Fit] = {
    "linear table": linear_table,
    "thin-plate table": thin_plate_table,
    "principal components": principal_components,
}


def _polynomial(degree: int) -> Fit:
    return lambda samples: samples.polynomial(degree)


def _structured(structure: str, regressor: Fit) -> FitView:
    return lambda captures: fit_structure(SEE_THROUGH, captures, structure, regressor)[0]


def _ours(structure: str, degree: int | None) -> FitView:
    return lambda captures: fit_see_through(captures, structure, degree).mapping


def _captures(bench: Bench, session: Session, used: BoolArray) -> SeeThroughCaptures:
    """Return the captures of some rows, for an eye box around all camera positions."""
    assert session.plan.see_through is not None
    assert session.readings.dot_pixel is not None
    every = see_through_captures(bench, session.plan.see_through, session.readings.dot_pixel)
    low, high = every.viewpoint.min(axis=0), every.viewpoint.max(axis=0)
    return select(replace(every, eye_box=EyeBox(0.5 * (low + high), high - low)), used)
