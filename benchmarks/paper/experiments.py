"""Experiments on the paper's claim: planar and volumetric sampling at equal degree, by depth, eye box and field."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

from benchmarks.paper.along_rays import DepthMeasure, DepthTrial, SeeThroughDepthTrial
from benchmarks.trial_study import Findings, Lines, Study, box_text, error_curves, trial_at
from benchmarks.trials import BACK_M, EvaluatedEye, Measure, Outcome
from wlr_render.numerics.polynomial import term_count
from wlr_render.report.blocks import Cell, Plot, ReportTable
from wlr_render.report.plots import curves

KINDS = ("planar", "volumetric")
DENSE = {"planar": 121, "volumetric": 125}
DEGREE, VIEWPOINTS = 5, 25
"""Limit of the total degree, and number of camera positions, in experiments that vary other parameters."""
SMALL_BOX_MM, LARGE_BOX_MM = (6.0, 4.0, 4.0), (14.0, 10.0, 12.0)
COUNTS = (9, 16, 25, 49, 84)
"""Numbers of camera positions."""
_CLEARLY = 1.05  # smallest clear ratio: the rms at random viewpoints is uncertain by about 5 %


@dataclass(frozen=True)
class Side:
    """Display or see-through model: its trial and the names of its errors.

    Attributes:
        trial: type of the trial, evaluated in the eye box and along rays.
        measure: the error that plots show, always an angle.
        other: the error of the opposite query.
        words, other_words: names of these errors, with the unit in brackets.
        queries: name, measure and unit of each contradiction along a ray.
    """

    trial: type[DepthTrial] | type[SeeThroughDepthTrial]
    measure: Measure
    other: Measure
    words: str
    other_words: str
    queries: Sequence[tuple[str, DepthMeasure, str]]


DISPLAY = Side(
    DepthTrial,
    Measure.FORWARD,
    Measure.BACKWARD,
    "forward rms, {} (arcmin)",
    "backward rms, {} (px)",
    (
        ("display forward: direction of a pixel", DepthMeasure.ALONG_RAY, "arcmin"),
        ("display backward: pixel of a view direction", DepthMeasure.PIXEL_ALONG_RAY, "px"),
    ),
)
SEE_THROUGH = Side(
    SeeThroughDepthTrial,
    Measure.REAL_POINT,
    Measure.REAL_RAY,
    "real point rms, {} (arcmin)",
    "world ray rms, {} (arcmin)",
    (
        ("see-through forward: direction of the world ray", DepthMeasure.ALONG_RAY, "arcmin"),
        ("see-through forward: place of the world ray", DepthMeasure.OFFSET_ALONG_RAY, "mm"),
        ("see-through backward: view direction of a real point", DepthMeasure.POINT_ALONG_RAY, "arcmin"),
    ),
)


def dense(side: Side, degrees: Sequence[int], study: Study) -> Findings:
    """Compare planar and volumetric sampling at equal total degree, with dense captures."""
    rows: list[list[Cell]] = []
    for eye, degree in product(study.eyes, degrees):
        pair = [_dense(side, study, eye, kind, degree) for kind in KINDS]
        ratio = pair[1].rms(side.measure) / pair[0].rms(side.measure)
        terms: list[Cell] = [term_count(4, degree), term_count(5, degree)]
        errors = [outcome.rms(measure) for measure in (side.measure, side.other) for outcome in pair]
        rows.append([str(eye), degree, *terms, *errors, ratio])
    columns = ["eye", "N", *_per_kind("terms, {}"), *_per_kind(side.words), *_per_kind(side.other_words)]
    columns.append("volumetric / planar")
    title = f"Dense, noise-free, equal degree: {DENSE['planar']} planar and {DENSE['volumetric']} volumetric viewpoints"
    table = ReportTable(title, columns, rows, (_where_not_better(rows),))
    return Findings((table, _over_degree("Dense, noise-free captures", side, study, degrees, side.measure)))


def _where_not_better(rows: Sequence[Sequence[Cell]]) -> str:
    not_better = [row for row in rows if isinstance(row[-1], float) and row[-1] < _CLEARLY]
    places = ", ".join(f"{row[0]} N={row[1]} ({row[-1]:.2f})" for row in not_better)
    sentence = f"At equal degree planar is not clearly better in {len(not_better)} of {len(rows)} cases"
    return f"{sentence} (volumetric / planar below {_CLEARLY}){': ' + places if places else ''}."


def depth(side: Side, degrees: Sequence[int], study: Study) -> Findings:
    """Measure errors behind the eye box on the rays of the fit, and contradictions along a ray."""
    rows: list[list[Cell]] = []
    for eye in study.eyes:
        pair = [_dense(side, study, eye, kind, DEGREE) for kind in KINDS]
        errors = [outcome.rms(measure) for measure in (side.measure, DepthMeasure.MOVED_BACK) for outcome in pair]
        rows.append([str(eye), *errors, *(_p95(outcome, DepthMeasure.ALONG_RAY) for outcome in pair)])
    columns = ["eye", *_per_kind("in the eye box, {} (arcmin)"), *_per_kind("moved back, {} (arcmin)")]
    columns += _per_kind("self-contradiction p95, {} (arcmin)")
    moved = f"Moved back {1e3 * BACK_M:g} mm along the same rays"
    over_degree = _over_degree(moved, side, study, degrees, DepthMeasure.MOVED_BACK)
    points: list[list[Cell]] = [[trace["name"], *trace["y"]] for trace in over_degree.data]
    title = f"{moved}: {side.words.split(',')[0]} (arcmin) over N, dense captures"
    at_degrees = ReportTable(title, ["curve", *(f"N={degree}" for degree in degrees)], points)
    return Findings((ReportTable(f"{moved}, N={DEGREE}, dense captures", columns, rows), at_degrees, over_degree))


def structure(study: Study) -> Findings:
    """Compare the results of all four mappings at two viewpoints on one ray, where they must be equal."""
    rows: list[list[Cell]] = []
    for eye, side in product(study.eyes, (DISPLAY, SEE_THROUGH)):
        pair = [_dense(side, study, eye, kind, DEGREE) for kind in KINDS]
        for query, measure, unit in side.queries:
            rows.append([str(eye), query, unit, *(_p95(outcome, measure) for outcome in pair)])
    title = f"Difference between two points of one ray, one eye box depth from each other: p95, N={DEGREE}, dense"
    notes = (
        "A planar model gives equal answers along a ray by construction, up to rounding and the solver's tolerance.",
        "The place of a world ray is compared at the depth of the real point.",
    )
    return Findings((ReportTable(title, ["eye", "query", "unit", *KINDS], rows, notes),))


def see_through_positions(study: Study) -> Findings:
    """Plot the see-through model's error over the number of camera positions; for the display see `accuracy`."""
    rows: list[list[Cell]] = []
    lines: Lines = {}
    for eye, kind in product(study.eyes, KINDS):
        trials = [trial_at(SeeThroughDepthTrial, eye, kind, None, count) for count in COUNTS]
        found = [study.outcome_of(trial).rms(Measure.REAL_POINT) for trial in trials]
        rows.append([str(eye), kind, *found])
        lines[f"{eye}, {kind}"] = COUNTS, found
    title = "Camera positions, noise-free, limits of the degree as in calibrate: real point rms"
    table = ReportTable(f"{title} (arcmin)", ["eye", "sampling", *(str(count) for count in COUNTS)], rows)
    return Findings((table, _error_plot(title, "number of camera positions", SEE_THROUGH, lines)))


def _dense(side: Side, study: Study, eye: EvaluatedEye, kind: str, degree: int) -> Outcome:
    return study.outcome_of(trial_at(side.trial, eye, kind, degree, DENSE[kind]))


def _p95(outcome: Outcome, measure: DepthMeasure) -> float:
    recorded = outcome.errors.get(measure)
    return float("nan") if recorded is None else recorded.p95


def _per_kind(column: str) -> list[str]:
    return [column.format(kind) for kind in KINDS]


def _over_degree(title: str, side: Side, study: Study, degrees: Sequence[int], measure: str) -> Plot:
    lines: Lines = {
        f"{eye}, {kind}": (degrees, [_dense(side, study, eye, kind, n).rms(measure) for n in degrees])
        for eye, kind in product(study.eyes, KINDS)
    }
    return _error_plot(title, "total degree N", side, lines)


def _error_plot(title: str, x_title: str, side: Side, lines: Lines) -> Plot:
    y_title = f"{side.words.split(',')[0]} (arcmin)"
    return curves(title, lines, (x_title, y_title), log_y=True, grouped=True)


def eye_box(study: Study) -> Findings:
    """Plot the error over the size of the eye box."""
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
    """Measure the error over the nominal field and over the whole panel."""
    rows: list[list[Cell]] = []
    for eye in study.eyes:
        trials = product((replace(eye, whole_panel=whole) for whole in (False, True)), KINDS)
        outcomes = [study.display(at, kind, DEGREE, VIEWPOINTS) for at, kind in trials]
        rows.append([str(eye), *(outcome.rms(Measure.FORWARD) for outcome in outcomes)])
    columns = ["eye", *_per_kind("nominal field, {} (arcmin)"), *_per_kind("whole panel, {} (arcmin)")]
    title = f"Size of the field: forward rms, N={DEGREE}, {VIEWPOINTS} viewpoints"
    return Findings((ReportTable(title, columns, rows),))
