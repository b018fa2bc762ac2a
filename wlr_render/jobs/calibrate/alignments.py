"""Fit a model to a wearer's alignments."""

from pathlib import Path

import numpy as np

from wlr_render.calibration.fit_alignments import AlignmentFit, fit_alignments
from wlr_render.captures.alignments_file import Alignments, load_alignments
from wlr_render.io.atomic_files import output_folder
from wlr_render.jobs.calibrate.calibrate_options import (
    CalibrateOptions,
    remove_results,
    require_readable_models,
    save_models,
)
from wlr_render.jobs.calibrate.fit_findings import eye_warnings
from wlr_render.jobs.options import ProgressArgument
from wlr_render.models.registration import model_registration_covariance
from wlr_render.numerics.arrays import FloatArray
from wlr_render.report.blocks import Cell, Report, ReportTable, decimals
from wlr_render.work.progress import SILENT

_DEPTHS_M = (0.4, 1.0, 3.0)
_CELLS = (9, 8)  # grid of pixels over the panel
_FEW = 20  # number of alignments beyond which more help less than a steadier hand
_RATIO = 1.5  # ratio of the farthest to the nearest point below which the place of the eye stays unknown


def calibrate_alignments(options: CalibrateOptions, *, progress: ProgressArgument = SILENT) -> Report:
    """Fit the model of one eye; write model.json and the report into `options.out`.

    Raises:
        BadInputError: the file cannot be read, or its alignments are too few, on a line, or contradictory.
    """
    require_readable_models(options.out)
    progress.say("fitting the model")
    found = load_alignments(options.path)
    fit = fit_alignments(found)
    folder = output_folder(options.out)
    remove_results(folder, [found.eye])
    model, notes = save_models(folder, [fit])
    predicted = [predicted_arcmin(fit, depth) for depth in _DEPTHS_M]
    rows: list[list[Cell]] = [[depth, error] for depth, error in zip(_DEPTHS_M, predicted, strict=True)]
    tables = [
        ReportTable("Predicted registration error", ["distance (m)", "rms over the panel (arcmin)"], rows, _NOTES),
        _table(found, fit),
    ]
    place, sigma = 1e3 * fit.eye_m, 1e3 * fit.eye_sigma_m
    doubted = f"; the others contradict number {_numbers(fit)}" if fit.doubtful else ""
    return Report(
        f"Calibration of {found.device}, {found.eye} eye, by alignments",
        verdict=f"{found.eye.capitalize()} eye: {len(found.pixel)} alignments predict points at 1 m to "
        f"{_arcmin(predicted[1])} rms, at 0.4 m to {_arcmin(predicted[0])}{doubted}. One alignment errs by "
        f"{fit.hand_arcmin:.2g}' per axis; the eye is at ({place[0]:.1f}, {place[1]:.1f}, {place[2]:.1f}) mm in the "
        f"device frame, known to ({sigma[0]:.1f}, {sigma[1]:.1f}, {sigma[2]:.1f}) mm.",
        advice=_advice(found, fit),
        warnings=[*eye_warnings(fit.mappings), *_warnings(found, fit), *notes],
        blocks=tables,
        inputs=[Path(options.path)],
        files=[model],
        record={"device": found.device, "eye": found.eye, "fit": fit.model().report},
    )


_NOTES = (
    "One sigma of direction of a pixel less direction of the point that it should cover, for the pupil where it was "
    "during the alignments. A constant error of the hand, which no alignment shows, counts as half of its random one.",
    "Ordinary headsets decide where the alignments do not: an unusual headset errs by more than predicted.",
)


def predicted_arcmin(fit: AlignmentFit, depth_m: float) -> float:
    """Return the predicted registration error, rms over the panel, at a depth in front of the wearer's eye."""
    eye, display = fit.mappings.eye_box.centre, fit.mappings.display
    pixel = display.panel.grid(*_CELLS).reshape(-1, 2)
    direction = display.view_dir_of_pixel(pixel, eye).value
    point = eye - direction / direction[:, 2:] * depth_m
    viewpoint = np.broadcast_to(eye, point.shape)
    parts = model_registration_covariance(fit.display, fit.see_through, pixel, viewpoint, point)
    total = np.sum([np.trace(each, axis1=1, axis2=2) for each in parts.values()], axis=0)
    return float(np.sqrt(np.nanmean(total)))


def _table(found: Alignments, fit: AlignmentFit) -> ReportTable:
    distance: FloatArray = np.linalg.norm(found.point - fit.eye_m, axis=1)
    rows: list[list[Cell]] = [
        [
            number + 1,
            *map(float, found.pixel[number]),
            float(distance[number]),
            float(left),
            "yes" if number + 1 in fit.doubtful else "",
        ]
        for number, left in enumerate(fit.residual_arcmin)
    ]
    columns = ["alignment", "u (px)", "v (px)", "distance (m)", "residual (arcmin)", "contradicted by the others"]
    return ReportTable("Alignments", columns, rows)


def _numbers(fit: AlignmentFit) -> str:
    """List the numbers of the alignments that the others contradict; empty if there are none."""
    return ", ".join(map(str, fit.doubtful))


def _arcmin(error: float) -> str:
    return f"{error:.{decimals(error, 2)}f}'"


def _advice(found: Alignments, fit: AlignmentFit) -> list[str]:
    distance = found.eye_box.centre[2] - found.point[:, 2]
    steps = []
    if numbers := _numbers(fit):
        steps.append(
            f"Align number {numbers} again, or remove it from {found.path}: it is in the model and distorts it."
        )
    if distance.max() < _RATIO * distance.min():
        steps.append(
            f"Align points at other distances too: all are {distance.min():.2g} to {distance.max():.2g} m away, which "
            "does not show the place of the eye, and points at other distances are predicted worse."
        )
    if len(found.pixel) < _FEW:
        steps.append(f"Align more points, up to {_FEW} or 30, also near the corners of the panel.")
    return steps


def _warnings(found: Alignments, fit: AlignmentFit) -> list[str]:
    warnings = ["The model holds for this wear: align again after the headset has moved on the head."]
    corners = np.array([[0.1, 0.1], [0.9, 0.1], [0.1, 0.9]]) * found.panel.size_px
    direction = fit.mappings.display.view_dir_of_pixel(corners, fit.mappings.eye_box.centre).value[:, :2]
    along, down = direction[1:] - direction[0]
    if along[0] * down[1] - along[1] * down[0] > 0:
        warnings.append(
            f"The wearer sees the panel mirrored: do the pixels of {found.path} run from the panel's left and top?"
        )
    return warnings
