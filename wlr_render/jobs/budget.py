"""The error budget of a headset: arcminutes of registration error by source, and what to improve first."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from wlr_render.budget.error_sizes import ErrorSizes, Truncation
from wlr_render.budget.eye_budget import PANEL_CELLS, DisparityShare, EyeBudget, disparity_shares, eye_budget
from wlr_render.budget.registration_budget import MODEL
from wlr_render.budget.statement import SourceShare
from wlr_render.error_sources import remedy
from wlr_render.io.input_files import prefix_errors
from wlr_render.jobs.budget_options import BudgetOptions
from wlr_render.jobs.headset import effect_warnings, headset_path, is_factory, is_model, open_eye
from wlr_render.jobs.job import job
from wlr_render.jobs.options import ProgressArgument, eyes_of
from wlr_render.mappings import Eye
from wlr_render.models.model_file import load_eye_model
from wlr_render.numerics.arrays import FloatArray
from wlr_render.report.blocks import Block, Cell, Columns, Plot, Report, ReportTable, Section, Text, cell_text, table
from wlr_render.report.plots import heat_map, small_heat_maps
from wlr_render.warp.choose_grid import choose_warp_grid
from wlr_render.work.progress import SILENT

_ADVISED = 3  # number of sources named as worth improving
_LEAST_SHARE = 0.005  # smallest share of the variance for which an owner is named
_LEAST_GAIN = 0.02  # smallest gain in radius for which the report advises halving a source


@job
def budget(options: BudgetOptions, *, progress: ProgressArgument = SILENT) -> Report:
    """State the error budget of a headset; writes budget.html, .md and .json into `options.out`.

    Raises:
        BadInputError: a model without covariance, without one of its mappings or without this eye, or a folder that
            cannot be written.
    """
    names = eyes_of(options.eye)
    eyes, sizes, found = [], [], []
    for name in progress(names, len(names), "eyes"):
        mappings, of_eye = opened_with_sizes(options, name)
        with prefix_errors(Path(options.headset)):
            found.append(eye_budget(mappings, options.depth_m, of_eye, options.camera_frame))
        eyes.append(mappings)
        sizes.append(of_eye)
    blocks: list[Block] = []
    for each, mappings in zip(found, eyes, strict=True):
        blocks += _eye_blocks(each, mappings, options.depth_m)
    disparity = disparity_shares(eyes, sizes, options.depth_m) if len(eyes) == 2 else []
    if disparity:
        blocks += [Section("Disparity of both eyes"), _disparity_table(disparity, options.depth_m)]
    blocks += [Section("How it is computed"), Text(_METHOD)]
    worst = max(found, key=lambda each: each.radius_arcmin)
    return Report(
        f"Error budget of {eyes[0].name}",
        verdict=_verdict(found, options.depth_m),
        advice=_advice(worst),
        warnings=_warnings(options.headset, found),
        blocks=blocks,
        inputs=[headset_path(options.headset)],
        record={"eyes": found, "disparity": disparity},
        stem="budget",
    )


def opened_with_sizes(options: BudgetOptions, eye: str) -> tuple[Eye, ErrorSizes]:
    """Open both mappings of an eye, and return them with the sizes of all errors except model errors.

    Raises:
        BadInputError: a faulty device or model, or one without that eye.
    """
    if is_model(options.headset):
        model = load_eye_model(options.headset, eye)
        mappings, truncation = model.mappings, Truncation.from_report(model.report)
    else:
        mappings, truncation = open_eye(options.headset, eye), Truncation()
    with prefix_errors(Path(options.headset)):
        grid = choose_warp_grid(mappings, np.eye(3))
    return mappings, options.sizes(grid.bound_arcmin, truncation)


def source_table(title: str, found: Mapping[str, Mapping[str, Any]], head: str, notes: Sequence[str]) -> ReportTable:
    """Return a table of predicted errors by source.

    Args:
        title: title of the table.
        found: by eye or map, a `PredictedError.record`.
        head: head of the column with the names of eyes or maps.
        notes: sentences on the errors.
    """
    rows: list[list[Cell]] = []
    for name, record in found.items():
        for each in record["sources"]:
            owner, _, source = each["name"].partition(": ")
            rows.append([name, each["name"], each["rms_arcmin"], remedy(source) if owner == MODEL else None])
        rows.append([name, "all", record["rms_arcmin"], None])
    columns = [head, "source", "rms (arcmin)", "what avoids it"]
    return ReportTable(title, columns, rows, [*notes, _SOURCES])


_SOURCES = (
    "Squares of the sources add up. model: truncation is the error of camera positions that the calibration left out, "
    "as far as no other source explains it."
)


def _verdict(found: Sequence[EyeBudget], depth_m: float) -> str:
    radii = [f"{cell_text(each.radius_arcmin)}'" for each in found]
    if len(found) > 1:
        radii = [f"{radius} ({each.eye} eye)" for radius, each in zip(radii, found, strict=True)]
    worst = max(found, key=lambda each: each.radius_arcmin)
    owners = [each for each in worst.owners if each.share >= _LEAST_SHARE]
    if not owners:
        return "The predicted error is zero: the mappings are exact, and all error sizes are zero."
    first, *others = owners
    rest = f" ({', '.join(f'{each.name} {100 * each.share:.0f} %' for each in others)})" if others else ""
    return (
        f"95 % of pixels lie within {' and '.join(radii)} of their real points at {depth_m:g} m, over {worst.region}; "
        f"the {first.name} causes {100 * first.share:.0f} % of the variance{rest}."
    )


def _advice(found: EyeBudget) -> list[str]:
    best = sorted(found.sources, key=lambda each: each.radius_if_halved_arcmin)
    worthwhile = [e for e in best if e.radius_if_halved_arcmin < (1.0 - _LEAST_GAIN) * found.radius_arcmin][:_ADVISED]
    words = ["Improve this first:", "Then", "Then"]
    return [
        f"{word} {_how(each.name)}: half as large, 95 % of pixels lie within "
        f"{cell_text(each.radius_if_halved_arcmin)}' instead of {cell_text(found.radius_arcmin)}'."
        for word, each in zip(words, worthwhile, strict=False)
    ]


_HOW = {
    "eye tracker: noise": "the noise of the eye tracker",
    "eye tracker: bias": "the constant error of the eye tracker (calibrate it for each wearer)",
    "eye tracker: latency": "the latency of the eye tracker, or its prediction",
    "head tracker: noise": "the noise of the head tracker",
    "head tracker: latency": "the latency that remains after prediction and late warp of the head pose",
    "drawing: whole pixels": "the drawing, by a filter",
    "drawing: corneal refraction": "the drawing, for more than one entrance pupil",
}


def _how(name: str) -> str:
    """Return what to improve against a source of errors, in words."""
    owner, _, source = name.partition(": ")
    if owner != MODEL:
        return _HOW.get(name, name)
    sentence = remedy(source)
    return f"the {source} ({sentence[0].lower()}{sentence[1:-1]})"


def _warnings(headset: str, found: Sequence[EyeBudget]) -> list[str]:
    warnings = [] if is_model(headset) else [f"{headset} is a device: its mappings are exact and have no errors."]
    if is_factory(headset):
        warnings = [f"{headset} is a factory calibration: its own errors are unknown, and are not in these figures."]
    warnings += effect_warnings(headset)
    for each in found:
        if each.left_out > 0.01:
            warnings.append(
                f"{100 * each.left_out:.0f} % of pixels and viewpoints of the {each.eye} eye lie outside the "
                "calibrated range or the eye's view; they do not count."
            )
    return warnings


def _eye_blocks(found: EyeBudget, eye: Eye, depth_m: float) -> list[Block]:
    cell = eye.display.panel.width_px / PANEL_CELLS
    everything = SourceShare("all", found.rms_arcmin, found.worst_arcmin, 1.0, found.radius_arcmin)
    rms, worst = {"rms (arcmin)": "rms_arcmin"}, {"worst pixel (arcmin)": "worst_arcmin"}
    share: Columns = {
        "share of variance (%)": lambda each: 100 * each.share,
        "95 % within, if halved (arcmin)": "radius_if_halved_arcmin",
    }
    shown = {name: each for name, each in found.rms_maps.items() if np.nanmax(each) > 0}
    return [
        Section(f"The {found.eye} eye"),
        table("By owner", found.owners, {"owner": "name", **rms, **share}),
        table(
            f"By source, at {depth_m:g} m",
            [*found.sources, everything],
            {"source": "name", **rms, **worst, **share},
            [
                "Rms lengths of the error, over both axes. If halved: the radius that contains 95 % of all errors if "
                "this source's standard deviation were half as large; in the last row, the radius now."
            ],
        ),
        table(
            "By region of the panel",
            found.regions.items(),
            {"95 % within (arcmin)": float},
            ["Edge, corner: one or both coordinates lie in the outer fifth on either side."],
            name="region",
        ),
        heat_map(
            f"95 % of errors lie within, {found.eye} eye",
            found.radius_map,
            "arcmin",
            cell=cell,
            caption="By place on the panel, over the eye box.",
        ),
        *([_source_maps(found.eye, shown, cell)] if shown else []),
    ]


def _source_maps(eye: str, maps: Mapping[str, FloatArray], cell: float) -> Plot:
    caption = "By place on the panel, over the eye box; one logarithmic scale. Sources of zero are not shown."
    return small_heat_maps(f"Rms error by source, {eye} eye", maps, "arcmin", cell=cell, caption=caption)


def _disparity_table(found: Sequence[DisparityShare], depth_m: float) -> ReportTable:
    columns = {
        "source": "source",
        "horizontal, rms (arcmin)": "horizontal_arcmin",
        "vertical, rms (arcmin)": "vertical_arcmin",
    }
    note = "Registration error of the right eye less the left eye's. Errors common to both eyes partly cancel."
    return table(f"Errors of disparity at {depth_m:g} m", found, columns, [note])


_METHOD = (
    "The registration error is the view direction of a pixel less the view direction of the real point that it should "
    "cover. Each source has a covariance at every pixel and viewpoint: model errors from the fit, tracker errors "
    "through the derivatives of both mappings. Sources are independent, and their covariances add up. Latency counts "
    "as random motion of the stated speed; the speed excludes saccades, during which vision is suppressed. Drawing "
    "errors count with their bound at every pixel, corneal refraction for an eye that looks straight ahead. Truncation "
    "is the error beyond the expected one at rows and columns of camera positions that the fit left out."
)
