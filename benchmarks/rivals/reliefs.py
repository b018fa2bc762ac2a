"""Transfer of methods from two eye reliefs of a lens to a third."""

import numpy as np

from benchmarks.rivals.displays import DISPLAYS, FitDisplay
from benchmarks.rivals.held_out import HeldOut, held_out, remark, rms_of
from wlr_render.captures.correspondences import DisplayCaptures, select
from wlr_render.geometry.directions import ARCMIN
from wlr_render.numerics.arrays import BoolArray, FloatArray
from wlr_render.report.blocks import Cell, ReportTable

FIELD_DEG = 30.0
"""Half angle of the tested field."""
_FITTED_DEG = 35.0  # half angle of the fit, larger than the tested field, so that no method is judged at the fit's edge


def relief_table(captures: DisplayCaptures) -> ReportTable:
    """Tabulate errors at each eye relief of models fitted to the other reliefs, rms over the tested field.

    Args:
        captures: one camera position for each eye relief, on the lens axis.
    """
    angle = np.degrees(np.arccos(-captures.view_dir[:, 2]))
    near = select(captures, angle <= _FITTED_DEG)
    tested = angle[angle <= _FITTED_DEG] <= FIELD_DEG
    reliefs = [float(near.viewpoint[near.capture == each][0, 2]) for each in np.unique(near.capture)]
    apart_mm = [f"{1e3 * (each - reliefs[0]):g} mm" for each in reliefs]
    rows: list[list[Cell]] = []
    for method, fit in DISPLAYS.items():
        errors: list[Cell] = []
        remarks = []
        for number in range(len(reliefs)):
            found = _predicted(method, fit, near, number, tested)
            remarks.append(remark(found))
            errors.append(None if remarks[-1] else rms_of(found))
        rows.append([method, *errors, next((each for each in remarks if each), None)])
    columns = ["method", *(f"{each} left out (arcmin)" for each in apart_mm), "remark"]
    rounding = float(np.sqrt(2.0) * np.median(near.sigma_arcmin))
    notes = (
        f"{tested.sum()} field angles up to {FIELD_DEG:g} degrees at {len(reliefs)} eye reliefs, from the nearest on; "
        f"fitted up to {_FITTED_DEG:g} degrees. The middle one is interpolated, the outer ones are extrapolated.",
        f"The lens's designer traced the tables and printed three digits: {rounding:.1f}' of rounding, both axes. "
        "There is no other noise, so there is no interval.",
    )
    return ReportTable("Eye reliefs that were not fitted", columns, rows, notes)


def _predicted(method: str, fit: FitDisplay, near: DisplayCaptures, out: int, tested: BoolArray) -> HeldOut:
    left = near.capture == out

    def error(number: int) -> FloatArray:
        rows = select(near, left & tested)
        seen = fit(select(near, ~left)).view_dir_of_pixel(rows.pixel, rows.viewpoint).value
        return np.asarray(np.linalg.norm(seen - rows.view_dir, axis=1) / ARCMIN)

    return held_out(method, np.zeros(int(np.sum(left & tested)), np.int64), error)
