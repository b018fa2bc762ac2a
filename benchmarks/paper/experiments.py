"""The experiments of the paper: planar and volumetric sampling at equal degree, in depth, by eye box and field."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import product

import numpy as np

from wlr_render.evaluation.mapping_error import DisplayObservations, displaced
from wlr_render.evaluation.metrics import Summary, summary
from wlr_render.geometry.directions import arcmin_between
from wlr_render.jobs.evaluate.study import Findings, Lines, Study, box_text, error_curves, trial_at
from wlr_render.jobs.evaluate.trials import DisplayTrial, EvaluatedEye, Measure, Outcome, display_observations
from wlr_render.mappings import DisplayMapping
from wlr_render.models.fitted_model import FittedDisplay
from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.polynomial import term_count
from wlr_render.report.blocks import Cell, Plot, ReportTable

KINDS = ("planar", "volumetric")
DENSE = {"planar": 121, "volumetric": 125}
DEGREE, VIEWPOINTS = 5, 25
"""Limit of the total degree, and camera positions, where an experiment varies something else."""
SMALL_BOX_MM, LARGE_BOX_MM = (6.0, 4.0, 4.0), (14.0, 10.0, 12.0)
BACK_M = 0.010
"""How far viewpoints are moved back along their own rays."""
_CLEARLY = 1.05  # a difference below 5 % is not clear: the rms at random viewpoints is uncertain by about that


class DepthMeasure(StrEnum):
    """Errors along the rays of random viewpoints.

    MOVED_BACK: direction of a pixel, from `BACK_M` farther back. ALONG_RAY: angle between the model's answers at two
    points of one of its rays, the eye box's depth apart.
    """

    MOVED_BACK = "moved back (arcmin)"
    ALONG_RAY = "along a ray (arcmin)"


@dataclass(frozen=True)
class DepthTrial(DisplayTrial):
    """A trial of the display model that is also evaluated along its rays."""

    def errors(self, model: FittedDisplay, rng: np.random.Generator, seed: int) -> dict[str, Summary]:
        """Errors of a fitted model, in the eye box and along rays."""
        seen = display_observations(self.at, seed)
        back = moved_back(seen, BACK_M)
        shown = model.view_dir_of_pixel(back.pixel, back.viewpoint).value
        # From half the eye box's depth before each viewpoint to half behind it.
        through = 1e-3 * self.eye_box_mm[2] / -seen.view_dir[:, 2]
        front = moved_back(seen, -0.5 * through).viewpoint
        return super().errors(model, rng, seed) | {
            DepthMeasure.MOVED_BACK: summary(arcmin_between(shown, back.view_dir)),
            DepthMeasure.ALONG_RAY: summary(self_inconsistency_arcmin(model, front, seen.pixel, through)),
        }


def moved_back(observations: DisplayObservations, distance_m: float | FloatArray) -> DisplayObservations:
    """The same rays with viewpoints moved back along them, by one distance or (n,) distances."""
    return displaced(observations, -np.asarray(distance_m)[..., None] * observations.view_dir)


def self_inconsistency_arcmin(
    candidate: DisplayMapping, viewpoint: FloatArray, pixel: FloatArray, distance_m: FloatArray
) -> FloatArray:
    """Self-inconsistency of a mapping along its own rays.

    Compares the direction of a pixel (..., 2) at a viewpoint (..., 3) with that at the viewpoint `distance_m` (...)
    farther back on the same ray, where it must be the same.

    Returns:
        (...) arcminutes, zero for any real display; NaN where the mapping has no value.
    """
    first = candidate.view_dir_of_pixel(pixel, viewpoint).value
    behind = viewpoint - np.asarray(distance_m)[..., None] * first
    return arcmin_between(first, candidate.view_dir_of_pixel(pixel, behind).value)


def dense(degrees: Sequence[int], study: Study) -> Findings:
    """Planar and volumetric sampling at equal total degree, with dense captures."""
    rows: list[list[Cell]] = []
    for eye, degree in product(study.eyes, degrees):
        pair = [_dense(study, eye, kind, degree) for kind in KINDS]
        ratio = pair[1].rms(Measure.FORWARD) / pair[0].rms(Measure.FORWARD)
        terms: list[Cell] = [term_count(4, degree), term_count(5, degree)]
        errors = [outcome.rms(measure) for measure in (Measure.FORWARD, Measure.BACKWARD) for outcome in pair]
        rows.append([str(eye), degree, *terms, *errors, ratio])
    columns = ["eye", "N", *_per_kind("terms, {}"), *_per_kind("forward rms, {} (arcmin)")]
    columns += [*_per_kind("backward rms, {} (px)"), "forward, volumetric / planar"]
    title = f"Dense, noise-free, equal degree: {DENSE['planar']} planar and {DENSE['volumetric']} volumetric viewpoints"
    table = ReportTable(title, columns, rows, (_where_not_better(rows),))
    return Findings((table, _over_degree("Dense, noise-free captures", study, degrees, Measure.FORWARD)))


def _where_not_better(rows: Sequence[Sequence[Cell]]) -> str:
    not_better = [row for row in rows if isinstance(row[-1], float) and row[-1] < _CLEARLY]
    places = ", ".join(f"{row[0]} N={row[1]} ({row[-1]:.2f})" for row in not_better)
    sentence = f"At equal degree planar is not clearly better in {len(not_better)} of {len(rows)} cases"
    return f"{sentence} (volumetric / planar below {_CLEARLY}){': ' + places if places else ''}."


def depth(degrees: Sequence[int], study: Study) -> Findings:
    """Errors behind the eye box on the rays that the model was fitted to, and contradictions along a ray."""
    rows: list[list[Cell]] = []
    for eye in study.eyes:
        pair = [_dense(study, eye, kind, DEGREE) for kind in KINDS]
        errors = [outcome.rms(measure) for measure in (Measure.FORWARD, DepthMeasure.MOVED_BACK) for outcome in pair]
        rows.append([str(eye), *errors, *(_p95(outcome) for outcome in pair)])
    columns = ["eye", *_per_kind("in the eye box, {} (arcmin)"), *_per_kind("moved back, {} (arcmin)")]
    columns += _per_kind("self-contradiction p95, {} (arcmin)")
    moved = f"Moved back {1e3 * BACK_M:g} mm along the same rays"
    over_degree = _over_degree(moved, study, degrees, DepthMeasure.MOVED_BACK)
    points: list[list[Cell]] = [[trace["name"], *trace["y"]] for trace in over_degree.data]
    title = f"{moved}: forward rms (arcmin) over N, dense captures"
    at_degrees = ReportTable(title, ["curve", *(f"N={degree}" for degree in degrees)], points)
    return Findings((ReportTable(f"{moved}, N={DEGREE}, dense captures", columns, rows), at_degrees, over_degree))


def _dense(study: Study, eye: EvaluatedEye, kind: str, degree: int) -> Outcome:
    return study.outcome_of(trial_at(DepthTrial, eye, kind, degree, DENSE[kind]))


def _p95(outcome: Outcome) -> float:
    recorded = outcome.errors.get(DepthMeasure.ALONG_RAY)
    return float("nan") if recorded is None else recorded.p95


def _per_kind(column: str) -> list[str]:
    return [column.format(kind) for kind in KINDS]


def _over_degree(title: str, study: Study, degrees: Sequence[int], measure: str) -> Plot:
    lines: Lines = {
        f"{eye}, {kind}": (degrees, [_dense(study, eye, kind, n).rms(measure) for n in degrees])
        for eye, kind in product(study.eyes, KINDS)
    }
    return error_curves(title, "total degree N", lines)


def eye_box(study: Study) -> Findings:
    """Error over the size of the eye box."""
    rows: list[list[Cell]] = []
    lines: Lines = {}
    for eye in study.eyes:
        boxes = [SMALL_BOX_MM, eye.eye_box_mm, LARGE_BOX_MM]
        outcomes = [study.display(replace(eye, eye_box_mm=box), "planar", DEGREE, VIEWPOINTS) for box in boxes]
        rows.append([str(eye), *(outcome.rms(Measure.FORWARD) for outcome in outcomes)])
        lines[str(eye)] = [0, 1, 2], [outcome.rms(Measure.FORWARD) for outcome in outcomes]
    names = [box_text(SMALL_BOX_MM), "as given", box_text(LARGE_BOX_MM)]
    settings = f"planar N={DEGREE}, {VIEWPOINTS} viewpoints, noise-free"
    plot = error_curves(f"Size of the eye box, {settings}", "eye box", lines)
    plot.layout["xaxis"].update(tickvals=[0, 1, 2], ticktext=names)
    title = f"Size of the eye box: forward rms (arcmin), {settings}"
    return Findings((ReportTable(title, ["eye", *names], rows), plot))


def field(study: Study) -> Findings:
    """Error over the nominal field and over the whole panel."""
    rows: list[list[Cell]] = []
    for eye in study.eyes:
        trials = product((replace(eye, whole_panel=whole) for whole in (False, True)), KINDS)
        outcomes = [study.display(at, kind, DEGREE, VIEWPOINTS) for at, kind in trials]
        rows.append([str(eye), *(outcome.rms(Measure.FORWARD) for outcome in outcomes)])
    columns = ["eye", *_per_kind("nominal field, {} (arcmin)"), *_per_kind("whole panel, {} (arcmin)")]
    title = f"Size of the field: forward rms, N={DEGREE}, {VIEWPOINTS} viewpoints"
    return Findings((ReportTable(title, columns, rows),))
