"""Tables of a session of both eyes or of several primaries: binocular alignment, and the models of each primary."""

import numpy as np

from wlr_render.calibration.calibrate_session import EyeCalibration, SessionCalibration
from wlr_render.captures.photo_session import SessionEntry
from wlr_render.geometry.directions import ARCMIN, tangents_of_dir
from wlr_render.models.fitted_model import FittedDisplay
from wlr_render.numerics.arrays import FloatArray
from wlr_render.report.blocks import Cell, ReportTable


def primaries_table(each: EyeCalibration) -> ReportTable:
    """Tabulate the predicted errors of the models of the primaries that are not in model.json."""
    rows: list[list[Cell]] = [
        [name, fit.display.report.predicted_arcmin, fit.display.report.noise_arcmin, fit.display.report.samples]
        for name, fit in each.primaries.items()
        if fit.display is not None
    ]
    columns = ["primary", "predicted rms error (arcmin)", "noise found (arcmin)", "samples"]
    note = "Each primary has its own model file, model-PRIMARY.json, with the see-through model of model.json."
    return ReportTable("Models of the other primaries", columns, rows, (note,))


def binocular_table(found: SessionCalibration) -> ReportTable:
    """Tabulate differences between both eyes' displays, and sigmas of the left camera's pose relative to the right."""
    eyes = [found.eyes[eye] for eye in ("left", "right")]
    entries = [_middle_entry(each, found) for each in eyes]
    sigma = found.bench.relative_sigma(*entries)
    apart: list[float | None] = [None] * 3
    displays = [each.fit.display for each in eyes]
    if displays[0] is not None and displays[1] is not None:
        apart = list(_apart_arcmin(displays[0].mapping, displays[1].mapping))
    names = ("vertical (arcmin)", "horizontal (arcmin)", "roll (arcmin)")
    rows: list[list[Cell]] = [
        [name, value, float(turned)] for name, value, turned in zip(names, apart, sigma[:3] / ARCMIN, strict=True)
    ]
    rows += [
        [f"position along {axis} (mm)", None, 1e3 * float(one)] for axis, one in zip("xyz", sigma[3:], strict=True)
    ]
    notes = (
        "Found: direction of the panel's middle from the middle of each eye box, and roll of its rows, left minus "
        "right. The models correct them. The horizontal value contains the convergence that the headset is designed "
        "for.",
        "Sigma: of the left camera's pose against the right one's, from their joint covariance, without errors that "
        "both share. A rotation by one sigma is an equal disparity between the eyes.",
    )
    return ReportTable("Binocular alignment", ["left against right eye", "found", "sigma"], rows, notes)


def _middle_entry(each: EyeCalibration, found: SessionCalibration) -> SessionEntry:
    """Return the entry whose camera is nearest to the middle of the eye box."""
    entries: list[SessionEntry] = [*each.session.display, *each.session.see_through]
    centre = each.session.eye_box.centre
    return min(entries, key=lambda entry: float(np.linalg.norm(found.bench.device_from_camera(entry)[:3, 3] - centre)))


def _apart_arcmin(left: FittedDisplay, right: FittedDisplay) -> tuple[float, float, float]:
    """Return the vertical, horizontal and roll differences of the displays, left minus right, arcminutes."""
    ends = [_middle_and_right(display) for display in (left, right)]
    (x, y), roll = (
        np.arctan(ends[0][0]) - np.arctan(ends[1][0]),
        [np.arctan2(*(far - near)[::-1]) for near, far in ends],
    )
    return float(y / ARCMIN), float(x / ARCMIN), float((roll[0] - roll[1]) / ARCMIN)


def _middle_and_right(display: FittedDisplay) -> FloatArray:
    """Return the tangents (2, 2), from the eye box's middle, of the panel's middle and of a pixel to its right."""
    pixel = display.panel.size_px * np.array([[0.5, 0.5], [0.7, 0.5]])
    return tangents_of_dir(display.view_dir_of_pixel(pixel, display.eye_box.centre).value)
