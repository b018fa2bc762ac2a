"""Experiments of `evaluate`: each runs trials and returns tables, plots and sentences."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product

import numpy as np

from wlr_render.jobs.evaluate.study import (
    ExperimentName,
    Findings,
    Study,
    pooled,
    pooled_cell,
    spread_note,
    trial_at,
)
from wlr_render.jobs.evaluate.trials import (
    BACK_M,
    FARTHEST_M,
    NEAREST_M,
    DisplayTrial,
    Measure,
    NoModelTrial,
    Outcome,
    SeeThroughTrial,
)
from wlr_render.numerics.polynomial import term_count
from wlr_render.report.blocks import Cell, Plot, ReportTable
from wlr_render.report.plots import curves

KINDS = ("planar", "volumetric")
DENSE = {"planar": 121, "volumetric": 125}
FIELD_VIEWPOINTS = {"planar": 25, "volumetric": 84}
DEGREE, VIEWPOINTS = 5, 25
"""Of the planar model where an experiment varies something else."""
NOISES_ARCMIN = (0.0, 0.25, 1.0)
SEE_THROUGH_NOISE_ARCMIN = 1.0
STAGE_ERROR_MM = 0.05
# 25 camera positions each: volumetric sampling can carry degree 3 on them and no more.
NOISE_MODELS = (("planar", 5), ("volumetric", 3), ("point-per-pixel", 5), ("static", 5))
SEE_THROUGH_MODELS = (("static", 3), ("volumetric", 3), ("planar", 3), ("planar", 5))
SMALL_BOX_MM, LARGE_BOX_MM = (6.0, 4.0, 4.0), (14.0, 10.0, 12.0)
Lines = dict[str, tuple[Sequence[float], Sequence[float]]]
"""Curves by name."""
_CLEARLY = 1.05  # a difference below 5 % is not clear: the rms at random viewpoints is uncertain by about that
_AT_FLOOR = 1.10  # an error at most 10 % above the smallest one found reaches the floor


@dataclass(frozen=True)
class PositionsNeeded:
    """The fewest camera positions that suffice for an eye, of those tried.

    Attributes:
        eye: which eye of which device.
        positions, degree, rms_arcmin: the choice; None if no choice suffices.
        fewer, fewer_rms_arcmin: the next smaller number of positions and its smallest error; None if there is none.
        wanted_arcmin: the error that suffices.
        is_largest: no larger number was tried.
    """

    eye: str
    positions: int | None
    degree: int | None
    rms_arcmin: float | None
    fewer: int | None
    fewer_rms_arcmin: float | None
    wanted_arcmin: float
    is_largest: bool = False

    def __str__(self) -> str:
        if self.positions is None:
            return f"{self.eye}: none of the numbers of camera positions tried reaches {self.wanted_arcmin:.2g}' rms."
        text = f"{self.eye}: {self.positions} camera positions suffice: {self.rms_arcmin:.2g}' rms with N={self.degree}"
        if self.fewer is not None:
            error = self.fewer_rms_arcmin
            text += f"; {self.fewer} " + ("are too few for a fit" if error is None else f"give {error:.2g}'")
        return text + (". More may still improve it: no larger number was tried." if self.is_largest else ".")


def positions_needed(eye: str, errors: Mapping[tuple[int, int], float], goal: float | None) -> PositionsNeeded:
    """The fewest camera positions whose error, and that of all larger numbers tried, suffices at one degree.

    Args:
        eye: its name.
        errors: rms in arcminutes by degree and number of camera positions; NaN where no model can be fitted.
        goal: the rms that suffices; None for 10 % above the smallest one.
    """
    finite = [error for error in errors.values() if np.isfinite(error)]
    wanted = goal or (_AT_FLOOR * min(finite) if finite else np.nan)
    counts = sorted({count for _, count in errors})
    sufficient = {
        (count, errors[degree, count], degree)
        for degree, count in errors
        if all(errors[degree, other] <= wanted for other in counts if other >= count)
    }
    if not sufficient:
        return PositionsNeeded(eye, None, None, None, None, None, wanted)
    count, rms, degree = min(sufficient)
    fewer = max((other for other in counts if other < count), default=None)
    with_fewer = [error for (_, other), error in errors.items() if other == fewer and np.isfinite(error)]
    is_largest = goal is None and count == counts[-1] and len(counts) > 1
    return PositionsNeeded(eye, count, degree, rms, fewer, min(with_fewer, default=None), wanted, is_largest)


def camera_positions(study: Study) -> Findings:
    """Error over the number of camera positions."""
    options = study.options
    noise, stage = options.noise_arcmin or 0.0, options.stage_error_mm or 0.0
    on_bench = partial(trial_at, DisplayTrial, camera_noise_arcmin=noise, stage_error_mm=stage)
    counts = sorted(set(options.counts))
    rows, other_rows, needed, groups = list[list[Cell]](), list[list[Cell]](), [], []
    lines: Lines = {}
    for eye in study.eyes:
        errors: dict[tuple[int, int], float] = {}
        for degree in options.degrees:
            fewest = term_count(3, degree)
            planar = [study.repeated(on_bench(eye, "planar", degree, count)) for count in counts]
            few = (fewest, fewest * 3 // 2)
            volumetric = [study.repeated(on_bench(eye, "volumetric", degree, count)) for count in few]
            groups += [*planar, *volumetric]
            cells = [pooled_cell(each, Measure.FORWARD) for each in (*planar, *volumetric)]
            rows.append([str(eye), degree, *cells[:-2]])
            other_rows.append([str(eye), degree, few[0], cells[-2], few[1], cells[-1]])
            rms = [pooled(each, Measure.FORWARD) for each in (*planar, *volumetric)]
            errors |= {(degree, count): error for count, error in zip(counts, rms[:-2], strict=True)}
            lines[f"{eye}, planar, N={degree}"] = counts, rms[:-2]
            lines[f"{eye}, volumetric, N={degree}"] = few, rms[-2:]
        needed.append(positions_needed(str(eye), errors, options.goal_arcmin))
    bench = f"camera noise {noise:g}', stage error {stage:g} mm" if noise or stage else "noise-free"
    notes = (spread_note(groups, Measure.FORWARD),) if noise or stage else ()
    columns = ["eye", "N", *(f"{count} positions (arcmin)" for count in counts)]
    other_columns = ["eye", "N", "fewest", "rms (arcmin)", "1.5 times the fewest", "rms on those (arcmin)"]
    return Findings(
        (
            ReportTable(f"Camera positions: forward rms of planar sampling, {bench}", columns, rows, notes),
            ReportTable(f"Camera positions that volumetric sampling needs, {bench}", other_columns, other_rows),
            _error_curves(f"Camera positions, {bench}", "number of camera positions", lines),
        ),
        verdict=[str(each) for each in needed],
        advice=[
            f"Calibrate {each.eye} with {each.positions} camera positions and a display model of degree {each.degree}."
            for each in needed
            if each.positions
        ],
        record={"camera_positions_needed": needed},
    )


def dense(study: Study) -> Findings:
    """Planar and volumetric sampling at equal degree, with more captures than either model needs."""
    rows: list[list[Cell]] = []
    for eye, degree in product(study.eyes, study.options.degrees):
        pair = [study.display(eye, kind, degree, DENSE[kind]) for kind in KINDS]
        ratio = pair[1].rms(Measure.FORWARD) / pair[0].rms(Measure.FORWARD)
        terms: list[Cell] = [term_count(4, degree), term_count(5, degree)]
        errors = [outcome.cell(measure) for measure in (Measure.FORWARD, Measure.BACKWARD) for outcome in pair]
        rows.append([str(eye), degree, *terms, *errors, ratio])
    columns = ["eye", "N", *_per_kind("terms, {}"), *_per_kind("forward rms, {} (arcmin)")]
    columns += [*_per_kind("backward rms, {} (px)"), "forward, volumetric / planar"]
    title = f"Dense, noise-free, equal degree: {DENSE['planar']} planar and {DENSE['volumetric']} volumetric viewpoints"
    table = ReportTable(title, columns, rows, (_where_not_better(rows),))
    return Findings((table, _over_degree("Dense, noise-free captures", study, Measure.FORWARD)))


def _where_not_better(rows: Sequence[Sequence[Cell]]) -> str:
    not_better = [row for row in rows if isinstance(row[-1], float) and row[-1] < _CLEARLY]
    places = ", ".join(f"{row[0]} N={row[1]} ({row[-1]:.2f})" for row in not_better)
    sentence = f"At equal degree planar is not clearly better in {len(not_better)} of {len(rows)} cases"
    return f"{sentence} (volumetric / planar below {_CLEARLY}){': ' + places if places else ''}."


def depth(study: Study) -> Findings:
    """Errors behind the eye box on the rays that the model was fitted to, and contradictions along a ray."""
    rows: list[list[Cell]] = []
    for eye in study.eyes:
        pair = [study.display(eye, kind, DEGREE, DENSE[kind]) for kind in KINDS]
        errors = [outcome.cell(measure) for measure in (Measure.FORWARD, Measure.MOVED_BACK) for outcome in pair]
        rows.append([str(eye), *errors, *(outcome.p95(Measure.ALONG_RAY) for outcome in pair)])
    columns = ["eye", *_per_kind("in the eye box, {} (arcmin)"), *_per_kind("moved back, {} (arcmin)")]
    columns += _per_kind("self-contradiction p95, {} (arcmin)")
    moved = f"Moved back {1e3 * BACK_M:g} mm along the same rays"
    over_degree = _over_degree(moved, study, Measure.MOVED_BACK)
    at_degrees = _table_of(f"{moved}: forward rms (arcmin) over N, dense captures", "N", over_degree)
    return Findings((ReportTable(f"{moved}, N={DEGREE}, dense captures", columns, rows), at_degrees, over_degree))


def _per_kind(column: str) -> list[str]:
    return [column.format(kind) for kind in KINDS]


def _over_degree(title: str, study: Study, measure: Measure) -> Plot:
    degrees = study.options.degrees
    lines: Lines = {
        f"{eye}, {kind}": (degrees, [study.display(eye, kind, n, DENSE[kind]).rms(measure) for n in degrees])
        for eye, kind in product(study.eyes, KINDS)
    }
    return _error_curves(title, "total degree N", lines)


def _error_curves(title: str, x_title: str, lines: Lines) -> Plot:
    return curves(title, lines, (x_title, "forward rms (arcmin)"), log_y=True, grouped=True)


def _table_of(title: str, x_name: str, plot: Plot) -> ReportTable:
    """The points of curves that share their x, one row for each curve."""
    columns = ["curve", *(f"{x_name}={x:g}" for x in plot.data[0]["x"])]
    return ReportTable(title, columns, [[trace["name"], *trace["y"]] for trace in plot.data])


def noise(study: Study) -> Findings:
    """Camera noise, on the models that 25 camera positions can carry and on the baselines."""
    levels = sorted({*NOISES_ARCMIN, study.options.noise_arcmin or 0.0})
    rows: list[list[Cell]] = []
    lines: Lines = {}
    noisy: list[list[Outcome]] = []
    for eye, (kind, degree) in product(study.eyes, NOISE_MODELS):
        groups = [
            study.repeated(trial_at(DisplayTrial, eye, kind, degree, VIEWPOINTS, camera_noise_arcmin=level))
            for level in levels
        ]
        errors = [pooled(group, Measure.FORWARD) for group in groups]
        rows.append([str(eye), kind, degree, *errors, pooled(groups[-1], Measure.BACKWARD)])
        lines[f"{eye}, {kind}"] = levels, errors
        noisy += groups[1:]
    columns = ["eye", "model", "N", *(f"forward rms at {level:g}' noise (arcmin)" for level in levels)]
    columns.append(f"backward rms at {levels[-1]:g}' noise (px)")
    title = f"Camera noise, {VIEWPOINTS} viewpoints (static: one)"
    plot = _error_curves(title, "camera noise (arcmin)", lines)
    return Findings((ReportTable(title, columns, rows, (spread_note(noisy, Measure.FORWARD),)), plot))


def position_errors(study: Study) -> Findings:
    """Errors of the stage during calibration, and of eye tracking in use."""
    tracking = study.options.tracking_error_mm
    stage = STAGE_ERROR_MM if study.options.stage_error_mm is None else study.options.stage_error_mm
    rows: list[list[Cell]] = []
    noisy: list[list[Outcome]] = []
    verdict = []
    for eye in study.eyes:
        trial = trial_at(DisplayTrial, eye, "planar", DEGREE, VIEWPOINTS)
        groups = [
            study.repeated(replace(trial, stage_error_mm=stage)),
            study.repeated(replace(trial, tracking_error_mm=tracking)),
        ]
        exact, by_stage, by_tracking = (pooled(each, Measure.FORWARD) for each in ([study.outcome_of(trial)], *groups))
        rows.append([str(eye), exact, by_stage, by_tracking])
        verdict.append(
            f"{eye}: {tracking:g} mm of eye-tracking error give {by_tracking:.2g}' rms, and {stage:g} mm of stage "
            f"error during calibration {by_stage:.2g}'; exact positions give {exact:.2g}'."
        )
        noisy += groups
    columns = ["eye", "exact positions (arcmin)", f"stage error {stage:g} mm (arcmin)"]
    columns.append(f"eye-tracking error {tracking:g} mm (arcmin)")
    title = f"Errors of position per axis: forward rms, planar N={DEGREE}, {VIEWPOINTS} viewpoints"
    return Findings((ReportTable(title, columns, rows, (spread_note(noisy, Measure.FORWARD),)),), verdict)


def eye_box(study: Study) -> Findings:
    """Error over the size of the eye box."""
    rows: list[list[Cell]] = []
    lines: Lines = {}
    for eye in study.eyes:
        boxes = [SMALL_BOX_MM, eye.eye_box_mm, LARGE_BOX_MM]
        outcomes = [study.display(replace(eye, eye_box_mm=box), "planar", DEGREE, VIEWPOINTS) for box in boxes]
        rows.append([str(eye), *(outcome.cell(Measure.FORWARD) for outcome in outcomes)])
        lines[str(eye)] = [0, 1, 2], [outcome.rms(Measure.FORWARD) for outcome in outcomes]
    names = [box_text(SMALL_BOX_MM), "as evaluated above", box_text(LARGE_BOX_MM)]
    settings = f"planar N={DEGREE}, {VIEWPOINTS} viewpoints, noise-free"
    plot = _error_curves(f"Size of the eye box, {settings}", "eye box", lines)
    plot.layout["xaxis"].update(tickvals=[0, 1, 2], ticktext=names)
    title = f"Size of the eye box: forward rms (arcmin), {settings}"
    return Findings((ReportTable(title, ["eye", *names], rows), plot))


def box_text(box: Sequence[float]) -> str:
    """Edge lengths in words, e.g. "10 x 8 x 6 mm"."""
    return " x ".join(f"{edge:g}" for edge in box) + " mm"


def field(study: Study) -> Findings:
    """Error over the nominal field and over the whole panel."""
    rows = [
        [
            str(eye),
            *(
                study.display(replace(eye, whole_panel=whole), kind, DEGREE, count).cell(Measure.FORWARD)
                for whole in (False, True)
                for kind, count in FIELD_VIEWPOINTS.items()
            ),
        ]
        for eye in study.eyes
    ]
    columns = ["eye", *_per_kind("nominal field, {} (arcmin)"), *_per_kind("whole panel, {} (arcmin)")]
    counts = " and ".join(f"{count} {kind}" for kind, count in FIELD_VIEWPOINTS.items())
    return Findings((ReportTable(f"Size of the field: forward rms, N={DEGREE}, {counts} viewpoints", columns, rows),))


def see_through(study: Study) -> Findings:
    """The world through the combiner: no model, a static one, planar and volumetric sampling."""
    given = study.options.noise_arcmin
    level = SEE_THROUGH_NOISE_ARCMIN if given is None else given
    rows: list[list[Cell]] = []
    repeated: list[list[Outcome]] = []
    for eye in study.eyes:
        without = study.outcome_of(NoModelTrial(eye))
        rows.append([str(eye), "none", None, without.cell(Measure.REAL_POINT), None, None, None])
        for kind, degree in SEE_THROUGH_MODELS:
            trial = trial_at(SeeThroughTrial, eye, kind, degree, VIEWPOINTS)
            exact, noisy = study.repeated(trial), study.repeated(replace(trial, camera_noise_arcmin=level))
            figures = [(exact, Measure.REAL_POINT), *((noisy, m) for m in (Measure.REAL_POINT, Measure.REAL_RAY))]
            errors = [pooled(*each) for each in (*figures, (noisy, Measure.MISS))]
            rows.append([str(eye), kind, degree, *errors])
            repeated.append(noisy)
    columns = ["eye", "model", "N", "real point, exact (arcmin)", f"real point, {level:g}' noise (arcmin)"]
    columns += [f"real ray, {level:g}' noise (arcmin)", f"miss, {level:g}' noise (mm)"]
    where = f"rms over real points at {NEAREST_M:g} to {FARTHEST_M:g} m"
    title = f"See-through: {where}, {VIEWPOINTS} viewpoints (static: one)"
    return Findings((ReportTable(title, columns, rows, (spread_note(repeated, Measure.REAL_POINT),)),))


EXPERIMENTS: dict[ExperimentName, Callable[[Study], Findings]] = {
    "camera-positions": camera_positions,
    "dense": dense,
    "noise": noise,
    "position-errors": position_errors,
    "depth": depth,
    "eye-box": eye_box,
    "field": field,
    "see-through": see_through,
}
