"""Published methods on a display that was decoded from two viewpoints, judged on parts of the panel outside the fit."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from benchmarks.published_data.viewpoint_evidence import BUNDLE, IGNORED, POINT, Survey
from benchmarks.rivals.displays import DISPLAYS, FitDisplay
from benchmarks.rivals.held_out import COLUMNS, HeldOut, cells, held_out
from wlr_render.calibration.readings import angular_metric
from wlr_render.captures.correspondences import DisplayCaptures, select
from wlr_render.geometry.directions import tangents_of_dir
from wlr_render.numerics.arrays import BoolArray, FloatArray
from wlr_render.report.blocks import Cell, ReportTable

REFERENCE = f"ours: {BUNDLE}"
_METHODS = tuple(
    name for name in DISPLAYS if not any(each in name for each in ("ours", "kernel", "process", "least squares"))
)  # kernels would take minutes here; our models are in `two-views`


def viewpoint_table(eyes: Sequence[DisplayCaptures]) -> ReportTable:
    """Tabulate errors of all methods in held-out cells of the panel, at both viewpoints, for each eye.

    Args:
        eyes: captures of each eye from two viewpoints.
    """
    rows: list[list[Cell]] = []
    noise = []
    for captures in eyes:
        survey = Survey.of(captures)
        noise.append(f"{captures.eye} {survey.noise_arcmin():.2f}'")
        judged = _judged(survey)
        reference = next(each for each in judged if each.method == REFERENCE)
        rows += [[captures.eye, each.method, len(each.error), *cells(each, reference)] for each in judged]
    columns = ["eye", "method", "readings", *(each.format(REFERENCE) for each in COLUMNS)]
    notes = (
        "An eighth of the cells of the panel is left out in turn. Intervals: bootstrap over the cells. Noise of the "
        f"decoded directions: {', '.join(noise)}.",
        "The readings are from the two viewpoints that were fitted: none of this says what happens between them.",
    )
    return ReportTable("Cells of a panel that were not fitted, from two viewpoints", columns, rows, notes)


def _judged(survey: Survey) -> list[HeldOut]:
    captures, fold, metric = survey.captures, survey.fold, angular_metric(survey.tangents)

    def angles(out: BoolArray, tangents: FloatArray) -> FloatArray:
        return np.asarray(np.linalg.norm((tangents - survey.tangents[out]) * metric[out, None], axis=1))

    def of_account(name: str, number: int) -> FloatArray:
        out = fold == number
        values = survey.fit(name, ~out).polynomial(captures.pixel[out])
        return angles(out, np.einsum("nop,np->no", survey.multiplier(name)[out], values))

    def of_display(fit: FitDisplay, number: int) -> FloatArray:
        out = fold == number
        tested = select(captures, out)
        seen = fit(select(captures, ~out)).view_dir_of_pixel(tested.pixel, tested.viewpoint).value
        return angles(out, tangents_of_dir(seen))

    found = [held_out(f"ours: {name}", fold, partial(of_account, name)) for name in (IGNORED, POINT, BUNDLE)]
    found += [held_out(name, fold, partial(of_display, DISPLAYS[name])) for name in _METHODS]
    return [replace(each, group=survey.cell) if each.refusal is None else each for each in found]
