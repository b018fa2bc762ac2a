"""Evaluate devices in simulation: model errors, and the number of camera positions that calibration needs."""

from collections.abc import Callable, Mapping
from dataclasses import KW_ONLY, dataclass, replace
from functools import partial
from itertools import product
from typing import Annotated, Literal, TypeVar

from wlr_render.jobs import limits
from wlr_render.jobs.evaluate.methods import DEFAULT_METHODS, chosen_methods, methods
from wlr_render.jobs.evaluate.study import (
    FOUND_COLUMNS,
    Findings,
    Lines,
    Study,
    StudyOptions,
    error_curves,
    found_cells,
    pooled,
    run_study,
    spread_note,
    trial_at,
    with_predicted,
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
from wlr_render.jobs.job import job
from wlr_render.jobs.options import Degree, OnlyWith, ProgressArgument, Range, described
from wlr_render.progress import SILENT
from wlr_render.report.blocks import Cell, Report, ReportTable

AnyCell = TypeVar("AnyCell")
ExperimentName = Literal["camera-positions", "noise", "position-errors", "see-through", "methods"]
_OWN_MODELS: tuple[ExperimentName, ...] = ("camera-positions", "noise", "position-errors", "see-through")
VIEWPOINTS = 25
"""Camera positions where an experiment varies something else."""
NOISES_ARCMIN = (0.0, 0.25, 1.0)
SEE_THROUGH_NOISE_ARCMIN = 1.0
STAGES_UM_URAD = ((0.0, 0.0), (10.0, 30.0), (30.0, 100.0))
"""Errors of stages per axis: shift and turn of the camera."""
STAGE_NOISE_ARCMIN = 0.25
"""Camera noise beside the errors of a stage."""
SAMPLINGS = ("planar", "volumetric")
NOISE_MODELS = ("planar", "volumetric", "point-per-pixel", "static")
SEE_THROUGH_MODELS = ("static", "volumetric", "planar")
_REPEATS, _FULL_REPEATS = 3, 10


@dataclass(frozen=True)
class EvaluateOptions(StudyOptions):
    """Options of `evaluate`."""

    _: KW_ONLY
    experiment: Annotated[
        tuple[ExperimentName, ...],
        described("Experiments to run, one or more (default: all but methods).", flag=True, many=True),
    ] = _OWN_MODELS
    methods: Annotated[
        tuple[str, ...] | None,
        described(
            "Compare methods, ours and published ones, in place of those experiments: all, or names of docs/methods.md "
            f"(default of the experiment methods: {', '.join(DEFAULT_METHODS)}).",
            flag=True,
            many=True,
        ),
        OnlyWith("experiment", ("methods",)),
    ] = None
    degrees: Annotated[
        tuple[int, ...] | None,
        described(
            "Limits of the display model's total degree to compare (default: the limits of `calibrate`).",
            flag=True,
            many=True,
        ),
        Degree,
        OnlyWith("experiment", ("camera-positions",)),
    ] = None
    counts: Annotated[
        tuple[int, ...],
        described("Numbers of camera positions to compare.", many=True),
        limits.PLACES,
        OnlyWith("experiment", ("camera-positions",)),
    ] = (5, 9, 12, 16, 25, 36, 49, 81, 121)
    goal_arcmin: Annotated[
        float,
        described("RMS error in arcmin that suffices; 0.1 is a tenth of what the eye resolves."),
        Range(above=0, at_most=600),
        OnlyWith("experiment", ("camera-positions",)),
    ] = 0.1
    noise_arcmin: Annotated[
        float | None,
        described(
            "Camera noise of your bench in arcmin per axis (default: none; 0.25 in position-errors, 1 in see-through)."
        ),
        limits.ANGLE_ARCMIN,
        OnlyWith("experiment", _OWN_MODELS),
    ] = None
    stage_error_mm: Annotated[
        float | None,
        described(
            "Camera position error of your bench in mm per axis (default: none; 0, 0.01 and 0.03 in position-errors)."
        ),
        limits.POSITION_MM,
        OnlyWith("experiment", ("camera-positions", "position-errors", "see-through")),
    ] = None
    stage_turn_urad: Annotated[
        float | None,
        described(
            "Camera rotation error of your bench in microradians per axis (default: none; 0, 30 and 100 in "
            "position-errors)."
        ),
        limits.ROTATION_URAD,
        OnlyWith("experiment", ("camera-positions", "position-errors", "see-through")),
    ] = None
    tracking_error_mm: Annotated[
        float,
        described("Error of eye tracking in mm per axis."),
        limits.POSITION_MM,
        OnlyWith("experiment", ("position-errors", "methods")),
    ] = 0.05
    repeats: Annotated[
        int | None,
        described("Repetitions of each trial with random errors (default: 3; 10 with --methods all)."),
        Range(at_least=1, at_most=1000),
    ] = None

    def __post_init__(self) -> None:
        # The default itself: who names the same experiments asks for them.
        if self.methods is not None and self.experiment is _OWN_MODELS:
            object.__setattr__(self, "experiment", ("methods",))
        super().__post_init__()


@dataclass(frozen=True)
class PositionsNeeded:
    """The fewest camera positions that suffice for an eye, of those tried.

    Attributes:
        eye: which eye of which device.
        wanted_arcmin: the rms that suffices.
        positions: the choice; None if no number suffices.
        degree: limit of the total degree, of the choice or of the best model; None for the limits of the fit.
        rms_arcmin: with the choice; without one, of the most camera positions.
        fewer, fewer_rms_arcmin: the next smaller number of positions and its smallest error; None if there is none.
    """

    eye: str
    wanted_arcmin: float
    positions: int | None
    degree: int | None
    rms_arcmin: float
    fewer: int | None = None
    fewer_rms_arcmin: float | None = None

    def __str__(self) -> str:
        limit = "" if self.degree is None else f" with N={self.degree}"
        if self.positions is None:
            return (
                f"{self.eye}: none of the numbers of camera positions tried reaches {self.wanted_arcmin:.2g}' rms; "
                f"the largest gives {self.rms_arcmin:.2g}'{limit}."
            )
        enough = f"{self.positions} camera positions suffice for {self.wanted_arcmin:.2g}'"
        text = f"{self.eye}: {enough}: {self.rms_arcmin:.2g}' rms{limit}"
        return text + (f"; {self.fewer} give {self.fewer_rms_arcmin:.2g}'." if self.fewer is not None else ".")


def positions_needed(eye: str, errors: Mapping[tuple[int | None, int], float], goal: float) -> PositionsNeeded:
    """The fewest camera positions whose error, and that of all larger numbers tried, suffices at one limit.

    Args:
        eye: its name.
        errors: rms in arcminutes by limit of the degree and number of camera positions.
        goal: the rms that suffices.
    """
    counts = sorted({count for _, count in errors})
    sufficient = [
        (count, error, degree)
        for (degree, count), error in errors.items()
        if all(errors[degree, other] <= goal for other in counts if other >= count)
    ]
    if not sufficient:
        rms, degree = min(((error, n) for (n, count), error in errors.items() if count == counts[-1]), key=_error)
        return PositionsNeeded(eye, goal, None, degree, rms)
    count, rms, degree = min(sufficient, key=lambda choice: choice[:2])
    fewer = max((other for other in counts if other < count), default=None)
    with_fewer = [error for (_, other), error in errors.items() if other == fewer]
    return PositionsNeeded(eye, goal, count, degree, rms, fewer, min(with_fewer, default=None))


def _error(choice: tuple[float, int | None]) -> float:
    return choice[0]


def camera_positions(options: EvaluateOptions, study: Study) -> Findings:
    """Error over the number of camera positions, of planar and volumetric sampling with as many positions."""
    errors_of_bench = _bench(options, 0.0)
    counts = sorted(set(options.counts))
    rows: list[list[Cell]] = []
    needed, groups = [], []
    lines: Lines = {}
    predicted: Lines = {}
    for eye in study.eyes:
        errors: dict[tuple[int | None, int], float] = {}
        for degree in options.degrees or (None,):
            by_count = [
                [
                    study.repeated(trial_at(DisplayTrial, eye, kind, degree, count, **errors_of_bench))
                    for kind in SAMPLINGS
                ]
                for count in counts
            ]
            for count, pair in zip(counts, by_count, strict=True):
                rms = [pooled(group, Measure.FORWARD) for group in pair]
                cells = [cell for group in pair for cell in with_predicted(group, Measure.FORWARD)]
                rows.append([str(eye), *_limit(options, degree), count, *cells, rms[1] / rms[0]])
                errors[degree, count] = rms[0]
                groups += pair
            for kind, each in zip(SAMPLINGS, zip(*by_count, strict=True), strict=True):
                name = f"{eye}, {kind}" + ("" if degree is None else f", N={degree}")
                lines[name] = counts, [pooled(group, Measure.FORWARD) for group in each]
                predicted[name] = counts, [pooled(group, Measure.PREDICTED) for group in each]
        needed.append(positions_needed(str(eye), errors, options.goal_arcmin))
    bench = _bench_words(errors_of_bench)
    notes = (spread_note(groups, Measure.FORWARD),) if any(errors_of_bench.values()) else ()
    columns = ["eye", *_limit(options, "N"), "camera positions"]
    columns += [f"{kind}{word} (arcmin)" for kind in SAMPLINGS for word in ("", ", predicted")]
    return Findings(
        (
            ReportTable(f"Camera positions: forward rms, {bench}", [*columns, "volumetric / planar"], rows, notes),
            error_curves(f"Camera positions, {bench}", "number of camera positions", lines, predicted),
        ),
        verdict=[str(each) for each in needed],
        advice=[f"Calibrate {each.eye} with {each.positions} camera positions." for each in needed if each.positions],
        record={"camera_positions_needed": needed},
    )


def _limit(options: EvaluateOptions, cell: AnyCell) -> list[AnyCell]:
    """The cell of the column N, which a table has where degrees are given."""
    return [] if options.degrees is None else [cell]


def _bench(options: EvaluateOptions, noise_arcmin: float) -> dict[str, float]:
    """Errors of the bench that a user gave, by field of a trial."""
    return {
        "camera_noise_arcmin": noise_arcmin if options.noise_arcmin is None else options.noise_arcmin,
        "stage_error_mm": options.stage_error_mm or 0.0,
        "stage_turn_urad": options.stage_turn_urad or 0.0,
    }


def _bench_words(errors: Mapping[str, float]) -> str:
    words = {"camera_noise_arcmin": "camera noise {:g}'", "stage_error_mm": "stage error {:g} mm"}
    words |= {"stage_turn_urad": "stage turn {:g} urad"}
    return ", ".join(text.format(errors[name]) for name, text in words.items() if errors[name]) or "noise-free"


def noise(options: EvaluateOptions, study: Study) -> Findings:
    """Camera noise, on models of 25 camera positions."""
    levels = sorted({*NOISES_ARCMIN, options.noise_arcmin or 0.0})
    rows: list[list[Cell]] = []
    lines: Lines = {}
    predicted: Lines = {}
    noisy: list[list[Outcome]] = []
    for eye, kind in product(study.eyes, NOISE_MODELS):
        groups = [
            study.repeated(trial_at(DisplayTrial, eye, kind, None, VIEWPOINTS, camera_noise_arcmin=level))
            for level in levels
        ]
        cells = [cell for group in groups for cell in with_predicted(group, Measure.FORWARD)]
        rows.append([str(eye), kind, *cells, found_cells(groups[-1])[0], pooled(groups[-1], Measure.BACKWARD)])
        lines[f"{eye}, {kind}"] = levels, [pooled(group, Measure.FORWARD) for group in groups]
        predicted[f"{eye}, {kind}"] = levels, [pooled(group, Measure.PREDICTED) for group in groups]
        noisy += groups[1:]
    columns = ["eye", "model"]
    columns += [f"{level:g}' noise{word} (arcmin)" for level in levels for word in ("", ", predicted")]
    columns += [f"{levels[-1]:g}' noise, noise found (arcmin)", f"{levels[-1]:g}' noise, backward (px)"]
    title = f"Camera noise: forward rms, {VIEWPOINTS} camera positions (static: one)"
    plot = error_curves(title, "camera noise (arcmin)", lines, predicted)
    return Findings((ReportTable(title, columns, rows, (spread_note(noisy, Measure.FORWARD),)), plot))


def position_errors(options: EvaluateOptions, study: Study) -> Findings:
    """Errors of the stage during calibration, and of eye tracking in use."""
    tracking = options.tracking_error_mm
    level = STAGE_NOISE_ARCMIN if options.noise_arcmin is None else options.noise_arcmin
    stages: tuple[tuple[float, float], ...] = STAGES_UM_URAD
    if options.stage_error_mm is not None or options.stage_turn_urad is not None:
        stages = ((0.0, 0.0), (1e3 * (options.stage_error_mm or 0.0), options.stage_turn_urad or 0.0))
    stages = tuple(dict.fromkeys(stages))
    rows: list[list[Cell]] = []
    tracking_rows: list[list[Cell]] = []
    noisy: list[list[Outcome]] = []
    verdict = []
    for eye in study.eyes:
        trial = trial_at(DisplayTrial, eye, "planar", None, VIEWPOINTS, camera_noise_arcmin=level)
        groups = [
            study.repeated(replace(trial, stage_error_mm=1e-3 * shift, stage_turn_urad=turn)) for shift, turn in stages
        ]
        tracked = study.repeated(replace(trial, tracking_error_mm=tracking))
        for (shift, turn), group in zip(stages, groups, strict=True):
            rows.append([str(eye), shift, turn, *with_predicted(group, Measure.FORWARD), *found_cells(group)])
        exact, by_tracking = (pooled(group, Measure.FORWARD) for group in (groups[0], tracked))
        tracking_rows.append([str(eye), exact, by_tracking])
        by_stage = ", ".join(
            f"{shift:g} um and {turn:g} urad of stage error {pooled(group, Measure.FORWARD):.2g}' "
            f"(predicted {pooled(group, Measure.PREDICTED):.2g}')"
            for (shift, turn), group in zip(stages, groups, strict=True)
            if shift or turn
        )
        verdict.append(
            f"{eye}: exact positions give {exact:.2g}' rms, {tracking:g} mm of eye-tracking error {by_tracking:.2g}'"
            + (f", {by_stage}." if by_stage else ".")
        )
        noisy += [*groups, tracked]
    bench = f"planar, {VIEWPOINTS} camera positions, camera noise {level:g}'"
    columns = ["eye", "stage shift (um)", "stage turn (urad)", "forward rms (arcmin)", "predicted (arcmin)"]
    notes = (spread_note(noisy, Measure.FORWARD), "Errors of the stage are per axis, new at each visit of a position.")
    tracking_columns = ["eye", "exact positions (arcmin)", f"eye-tracking error {tracking:g} mm (arcmin)"]
    return Findings(
        (
            ReportTable(f"Errors of the stage, {bench}", [*columns, *FOUND_COLUMNS], rows, notes),
            ReportTable(f"Errors of eye tracking per axis: forward rms, {bench}", tracking_columns, tracking_rows),
        ),
        verdict,
    )


def see_through(options: EvaluateOptions, study: Study) -> Findings:
    """The world through the combiner: no model, a static one, planar and volumetric sampling."""
    errors_of_bench = _bench(options, SEE_THROUGH_NOISE_ARCMIN)
    bench = _bench_words(errors_of_bench)
    rows: list[list[Cell]] = []
    repeated: list[list[Outcome]] = []
    for eye in study.eyes:
        without = study.outcome_of(NoModelTrial(eye))
        rows.append([str(eye), "none", without.rms(Measure.REAL_POINT), *[None] * 8])
        for kind in SEE_THROUGH_MODELS:
            benches: tuple[dict[str, float], ...] = ({}, errors_of_bench)
            exact, noisy = (
                study.repeated(trial_at(SeeThroughTrial, eye, kind, None, VIEWPOINTS, **errors)) for errors in benches
            )
            cells = [cell for group in (exact, noisy) for cell in with_predicted(group, Measure.REAL_POINT)]
            others = [pooled(noisy, measure) for measure in (Measure.REAL_RAY, Measure.MISS)]
            rows.append([str(eye), kind, *cells, *others, *found_cells(noisy)])
            repeated.append(noisy)
    columns = ["eye", "model"]
    columns += [f"real point, {level}{word} (arcmin)" for level in ("exact", "noisy") for word in ("", ", predicted")]
    columns += ["real ray, noisy (arcmin)", "miss, noisy (mm)", *FOUND_COLUMNS]
    where = f"rms over real points at {NEAREST_M:g} to {FARTHEST_M:g} m"
    title = f"See-through: {where}, {VIEWPOINTS} camera positions (static: one)"
    notes = (f"Noisy: {bench}.", spread_note(repeated, Measure.REAL_POINT))
    return Findings((ReportTable(title, columns, rows, notes),))


EXPERIMENTS: dict[ExperimentName, Callable[[EvaluateOptions, Study], Findings]] = {
    "camera-positions": camera_positions,
    "noise": noise,
    "position-errors": position_errors,
    "see-through": see_through,
    "methods": lambda options, study: methods(chosen_methods(options.methods), options.tracking_error_mm, study),
}
_DEFAULTS = EvaluateOptions()


@job
def evaluate(options: EvaluateOptions = _DEFAULTS, *, progress: ProgressArgument = SILENT) -> Report:
    """Evaluate devices in simulation by the chosen experiments; writes the report into `options.out`.

    Raises:
        BadInputError: see `run_study`.
    """
    chosen = {str(name): partial(EXPERIMENTS[name], options) for name in options.experiment}
    repeats = options.repeats or (_FULL_REPEATS if options.methods == ("all",) else _REPEATS)
    return run_study("Evaluation", options, chosen, "report", progress, repeats)
