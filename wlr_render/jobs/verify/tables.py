"""How far drawn dots lie from real ones, in tables."""

from collections.abc import Sequence

import numpy as np

from wlr_render.evaluation.metrics import summary
from wlr_render.jobs.verify.judgement import Judged
from wlr_render.report.blocks import Cell, ReportTable

_COLUMNS = ("dots", "median (arcmin)", "rms (arcmin)", "p95 (arcmin)", "max (arcmin)", "noise of a dot (arcmin)")


def misalignment_tables(judged: Sequence[Judged], models: str) -> tuple[ReportTable, ReportTable]:
    """Over everything, by method; and one row for each place (target distance and viewpoint) and method."""
    methods = list(dict.fromkeys(one.method for one in judged))
    overall = [[method, *_figures([one for one in judged if one.method == method])] for method in methods]
    known = all(one.place.depth_m is not None for one in judged)
    head = ("target (m)", "viewpoint") if known else ("photographs",)
    each = [[*_where(one, known), one.method, *_figures([one]), one.complaint or None] for one in judged]
    notes = (
        "Angle at the camera between a dot of the real target and the same dot as drawn, from two photographs.",
        "Noise of a dot: standard deviation per axis that the noise of both photographs alone makes.",
    )
    return (
        ReportTable(f"Misalignment from photographs, {models}", ("method", *_COLUMNS), overall, notes),
        ReportTable("By target distance and viewpoint", (*head, "method", *_COLUMNS, "complaint"), each),
    )


def _where(one: Judged, known: bool) -> list[Cell]:
    return [one.place.depth_m, one.place.viewpoint] if known else [one.place.name]


def _figures(judged: Sequence[Judged]) -> list[Cell]:
    found = [one.misalignment for one in judged if one.misalignment is not None]
    angle = np.concatenate([one.arcmin for one in found]) if found else np.empty(0)
    noise = np.concatenate([one.sigma_arcmin for one in found]) if found else np.empty(0)
    figures = summary(angle)
    return [
        len(angle),
        figures.median,
        figures.rms,
        figures.p95,
        figures.maximum,
        float(np.median(noise)) if len(noise) else None,
    ]
