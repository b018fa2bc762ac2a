"""Evaluate devices in simulation: model errors, and the number of camera positions that calibration needs."""

from collections.abc import Callable, Mapping
from dataclasses import KW_ONLY, dataclass, replace
from functools import partial
from itertools import product
from typing import Annotated, Literal, get_args

import numpy as np

from wlr_render.jobs.evaluate.study import (
    Findings,
    Lines,
    Study,
    StudyOptions,
    error_curves,
    pooled,
    pooled_cell,
    run_study,
    spread_note,
    trial_at,
)
from wlr_render.jobs.evaluate.trials import (
    FARTHEST_M,
    NEAREST_M,
    DisplayTrial,
    Measure,
    NoModelTrial,
    Outcome,
    SeeThroughTrial,
)
from wlr_render.jobs.options import Degree, OnlyWith, ProgressArgument, Range, described
from wlr_render.numerics.polynomial import term_count
from wlr_render.progress import SILENT
from wlr_render.report.blocks import Cell, Report, ReportTable

ExperimentName = Literal["camera-positions", "noise", "position-errors", "see-through"]
DEGREE, VIEWPOINTS = 5, 25
"""Of the planar model where an experiment varies something else."""
NOISES_ARCMIN = (0.0, 0.25, 1.0)
SEE_THROUGH_NOISE_ARCMIN = 1.0
STAGE_ERROR_MM = 0.05
# 25 camera positions each: volumetric sampling can carry degree 3 on them and no more.
NOISE_MODELS = (("planar", 5), ("volumetric", 3), ("point-per-pixel", 5), ("static", 5))
SEE_THROUGH_MODELS = (("static", 3), ("volumetric", 3), ("planar", 3), ("planar", 5))
_NOT_NEGATIVE = Range(at_least=0)
_AT_FLOOR = 1.10  # an error at most 10 % above the smallest one found reaches the floor


@dataclass(frozen=True)
class EvaluateOptions(StudyOptions):
    """Options of `evaluate`."""

    _: KW_ONLY
    experiment: Annotated[
        tuple[ExperimentName, ...], described("Experiments to run, one or more (default: all).", flag=True, many=True)
    ] = get_args(ExperimentName)
    degrees: Annotated[
        tuple[int, ...],
        described("Polynomial degrees of the display model.", many=True),
        Degree,
        OnlyWith("experiment", ("camera-positions",)),
    ] = (3, 4, 5)
    counts: Annotated[
        tuple[int, ...],
        described("Numbers of camera positions to compare.", many=True),
        Range(at_least=1, at_most=1000),
        OnlyWith("experiment", ("camera-positions",)),
    ] = (12, 16, 21, 25, 36, 49, 81, 121)
    goal_arcmin: Annotated[
        float | None,
        described("RMS error in arcmin that suffices (default: at most 10 % above the smallest error found)."),
        Range(above=0),
        OnlyWith("experiment", ("camera-positions",)),
    ] = None
    noise_arcmin: Annotated[
        float | None,
        described("Camera noise of your bench in arcmin per axis (default: none; 1' in see-through)."),
        _NOT_NEGATIVE,
        OnlyWith("experiment", ("camera-positions", "noise", "see-through")),
    ] = None
    stage_error_mm: Annotated[
        float | None,
        described("Camera position error of your bench in mm per axis (default: none; 0.05 in position-errors)."),
        _NOT_NEGATIVE,
        OnlyWith("experiment", ("camera-positions", "position-errors")),
    ] = None
    tracking_error_mm: Annotated[
        float,
        described("Error of eye tracking in mm per axis."),
        _NOT_NEGATIVE,
        OnlyWith("experiment", ("position-errors",)),
    ] = 0.05
    repeats: Annotated[
        int, described("Repetitions of each trial with random errors."), Range(at_least=1, at_most=1000)
    ] = 3


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


def camera_positions(options: EvaluateOptions, study: Study) -> Findings:
    """Error over the number of camera positions."""
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
            error_curves(f"Camera positions, {bench}", "number of camera positions", lines),
        ),
        verdict=[str(each) for each in needed],
        advice=[
            f"Calibrate {each.eye} with {each.positions} camera positions and a display model of degree {each.degree}."
            for each in needed
            if each.positions
        ],
        record={"camera_positions_needed": needed},
    )


def noise(options: EvaluateOptions, study: Study) -> Findings:
    """Camera noise, on the models that 25 camera positions can carry and on the baselines."""
    levels = sorted({*NOISES_ARCMIN, options.noise_arcmin or 0.0})
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
    plot = error_curves(title, "camera noise (arcmin)", lines)
    return Findings((ReportTable(title, columns, rows, (spread_note(noisy, Measure.FORWARD),)), plot))


def position_errors(options: EvaluateOptions, study: Study) -> Findings:
    """Errors of the stage during calibration, and of eye tracking in use."""
    tracking = options.tracking_error_mm
    stage = STAGE_ERROR_MM if options.stage_error_mm is None else options.stage_error_mm
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


def see_through(options: EvaluateOptions, study: Study) -> Findings:
    """The world through the combiner: no model, a static one, planar and volumetric sampling."""
    given = options.noise_arcmin
    level = SEE_THROUGH_NOISE_ARCMIN if given is None else given
    rows: list[list[Cell]] = []
    repeated: list[list[Outcome]] = []
    for eye in study.eyes:
        without = study.outcome_of(NoModelTrial(eye))
        rows.append([str(eye), "none", None, without.rms(Measure.REAL_POINT), None, None, None])
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


EXPERIMENTS: dict[ExperimentName, Callable[[EvaluateOptions, Study], Findings]] = {
    "camera-positions": camera_positions,
    "noise": noise,
    "position-errors": position_errors,
    "see-through": see_through,
}
_DEFAULTS = EvaluateOptions()


def evaluate(options: EvaluateOptions = _DEFAULTS, *, progress: ProgressArgument = SILENT) -> Report:
    """Evaluate devices in simulation by the chosen experiments; writes the report into `options.out`.

    Raises:
        BadInputError: see `run_study`.
    """
    chosen = {str(name): partial(EXPERIMENTS[name], options) for name in options.experiment}
    return run_study("Evaluation", options, chosen, "report", progress, options.repeats)
