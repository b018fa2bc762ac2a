"""Shared parts of the calibrate verbs: options of the fit, and tables of fit quality."""

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np

from wlr_render.calibration.fit_eye import EyeFit, fit_eye
from wlr_render.calibration.fit_report import FitReport
from wlr_render.captures.correspondences import DisplayCaptures, EyeCaptures, SeeThroughCaptures
from wlr_render.geometry.directions import arcmin_between, tangents_of_dir
from wlr_render.jobs.options import Degree, Options, described
from wlr_render.models.model_file import add_eye_models
from wlr_render.numerics.arrays import FloatArray
from wlr_render.report.blocks import Block, Cell, Plot, ReportTable
from wlr_render.report.plots import arrow_map, axis, bars

MODEL_FILE = "model.json"


@dataclass(frozen=True)
class FitOptions(Options):
    """Options of the fit, which every `calibrate` verb has."""

    _: KW_ONLY
    kind: Annotated[Literal["planar", "volumetric", "static", "point-per-pixel"], described("Model type.")] = "planar"
    degree: Annotated[
        int | None,
        described("Polynomial degree of the display model (default: chosen by cross-validation)."),
        Degree,
    ] = None
    see_through_degree: Annotated[
        int | None,
        described("Polynomial degree of the see-through model (default: chosen by cross-validation)."),
        Degree,
    ] = None

    def fit(self, captures: EyeCaptures) -> EyeFit:
        """Fit the models of one eye."""
        return fit_eye(captures, self.kind, self.degree, self.see_through_degree)


DEFAULT_FIT = FitOptions()
OutputFolder = Annotated[
    Path, described("Output folder. If its model.json holds the other eye of the same device, that eye stays.")
]


def save_models(folder: Path, fits: Sequence[EyeFit]) -> tuple[Path, tuple[str, ...]]:
    """Write model.json; returns its path, and a sentence if another eye of an earlier run stays in it."""
    path = folder / MODEL_FILE
    kept = add_eye_models(path, [fit.model() for fit in fits])
    return path, tuple(f"{path} also holds the {eye} eye, from an earlier run." for eye in kept)


def fit_sentence(fit: EyeFit) -> str:
    """Degrees and errors of the models in one sentence."""
    parts = []
    for name, report in _reports(fit):
        held_out = report.held_out_at_degree()
        predicted = f" ({held_out.rms:.3g}' at held-out camera positions)" if held_out else ""
        parts.append(f"{name} residual {report.residual_arcmin.rms:.3g}' rms{predicted} with N={report.degree}")
    return f"{fit.mappings.eye.capitalize()} eye: {'; '.join(parts)}."


def fit_blocks(fit: EyeFit, captures: EyeCaptures, display_names: Sequence[str] = ()) -> list[Block]:
    """Tables and plots of held-out errors and residuals.

    Args:
        fit: the models.
        captures: what they were fitted to.
        display_names: names of the display's camera positions; empty to number them.
    """
    blocks: list[Block] = [_residual_table(fit), _held_out_table(fit)]
    if any(len(report.held_out_arcmin) > 1 for _, report in _reports(fit)):
        blocks.append(_held_out_plot(fit))
    return [*blocks, *_residual_plots(fit, captures, display_names)]


def _residual_table(fit: EyeFit) -> ReportTable:
    rows: list[list[Cell]] = []
    for name, report in _reports(fit):
        held_out = report.held_out_at_degree()
        sizes: list[Cell] = [report.kind, report.degree, report.viewpoints, report.samples, report.condition]
        residual = report.residual_arcmin
        rows.append([name, *sizes, residual.rms, residual.p95, held_out.rms if held_out else None, report.unsolved])
    columns = ["mapping", "model", "N", "viewpoints", "samples", "condition", "residual rms (arcmin)"]
    columns += ["residual p95 (arcmin)", "held-out rms (arcmin)", "unsolved"]
    return ReportTable("Fit", columns, rows, ("Held-out: camera positions that were left out of the fit.",))


def _held_out_table(fit: EyeFit) -> ReportTable:
    rows = [
        [name, tried.degree, tried.rms, tried.standard_error, "chosen" if tried.degree == report.degree else ""]
        for name, report in _reports(fit)
        for tried in report.held_out_arcmin
    ]
    columns = ["mapping", "N", "held-out rms (arcmin)", "its standard error (arcmin)", "degree"]
    return ReportTable("Held-out camera positions, by degree", columns, rows)


def _held_out_plot(fit: EyeFit) -> Plot:
    data = []
    for name, report in _reports(fit):
        tried = report.held_out_arcmin
        data.append(
            {
                "type": "scatter",
                "mode": "lines+markers",
                "name": f"{name}, N={report.degree} in use",
                "x": [each.degree for each in tried],
                "y": [each.rms for each in tried],
                "error_y": {"type": "data", "array": [each.standard_error for each in tried]},
                "marker": {"size": [14 if each.degree == report.degree else 6 for each in tried]},
            }
        )
    layout = {"xaxis": axis("degree N") | {"dtick": 1}, "yaxis": axis("held-out rms (arcmin)", log=True)}
    caption = "Error at camera positions that were left out of the fit; large markers are the degrees in use."
    return Plot("Held-out error by degree", data, layout, caption)


def _residual_plots(fit: EyeFit, captures: EyeCaptures, display_names: Sequence[str]) -> list[Plot]:
    """Residual of each camera position (and target pose), and maps of the residuals."""
    display, see_through = captures.display, captures.see_through
    assert see_through is not None
    seen = fit.mappings.display.view_dir_of_pixel(display.pixel, display.viewpoint).value
    residual = _residuals(display, seen)
    names = np.array([display_names[each] if display_names else f"position {each:02d}" for each in display.capture])
    maps = {"display": {name: (display.pixel[names == name], residual[names == name]) for name in np.unique(names)}}
    seen = fit.mappings.see_through.view_dir_of_real_point(see_through.point, see_through.viewpoint).value
    residual = _residuals(see_through, seen)
    field = np.rad2deg(np.arctan(see_through.tangents))
    rows = zip(see_through.target_pose, see_through.capture, strict=True)
    names = np.array([f"target {pose}, position {capture:02d}" for pose, capture in rows])
    maps["see-through"] = {name: (field[names == name], residual[names == name]) for name in np.unique(names)}
    plots = []
    for side, groups in maps.items():
        rms = [float(np.sqrt(np.nanmean(np.sum(arrow**2, axis=1)))) for _, arrow in groups.values()]
        caption = (
            "A photograph, or set of photographs, that stands out was taken at a position other than its entry states."
        )
        plots.append(
            bars(
                f"Residual of the {side}, by camera position",
                list(groups),
                {side: rms},
                "rms (arcmin)",
                caption=caption,
            )
        )
    plots.append(
        arrow_map(
            "Residual map of the display",
            maps["display"],
            "arcmin",
            ("u (px)", "v (px)"),
            y_down=True,
            caption="Direction measured minus modelled, over the panel.",
        )
    )
    plots.append(
        arrow_map(
            "Residual map of the see-through",
            maps["see-through"],
            "arcmin",
            ("to the right (degrees)", "up (degrees)"),
            caption="Direction measured minus modelled, over the field of view.",
        )
    )
    return plots


def _residuals(captures: DisplayCaptures | SeeThroughCaptures, modelled: FloatArray) -> FloatArray:
    """(n, 2) right and up, arcminutes: as long as the angle, whatever a tangent is worth so far off the axis."""
    apart = captures.tangents - tangents_of_dir(modelled)
    size = arcmin_between(captures.view_dir, modelled)
    return np.asarray(apart * (size / np.maximum(np.linalg.norm(apart, axis=1), 1e-12))[:, None])


def _reports(fit: EyeFit) -> tuple[tuple[str, FitReport], ...]:
    return ("display", fit.display), ("see-through", fit.see_through)
