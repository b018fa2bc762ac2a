"""Options of `evaluate`, and shared parts of its experiments."""

from collections.abc import Callable, Sequence
from dataclasses import KW_ONLY, dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, get_args

import numpy as np

from wlr_render.jobs.evaluate.trials import (
    AnyTrial,
    DisplayTrial,
    EvaluatedEye,
    Measure,
    Outcome,
    SeeThroughTrial,
    Trial,
)
from wlr_render.jobs.options import BoxSize, Degree, Eyes, OnlyWith, Options, Range, Seed, Workers, described
from wlr_render.report.blocks import Block, Cell

ExperimentName = Literal[
    "camera-positions", "dense", "noise", "position-errors", "depth", "eye-box", "field", "see-through"
]
NOT_NEGATIVE = Range(at_least=0)
AnyOwnTrial = TypeVar("AnyOwnTrial", bound=Trial)


@dataclass(frozen=True)
class EvaluateOptions(Options):
    """Options of `evaluate`."""

    device: Annotated[tuple[str, ...], described("Shipped devices or device files (.toml).", many=True)] = (
        "northstar",
        "freeform40",
        "birdbath28",
    )
    _: KW_ONLY
    eye: Annotated[Eyes, described("Eyes to evaluate.")] = "right"
    box: BoxSize = None
    experiment: Annotated[
        tuple[ExperimentName, ...], described("Experiments to run, one or more (default: all).", flag=True, many=True)
    ] = get_args(ExperimentName)
    degrees: Annotated[
        tuple[int, ...],
        described("Polynomial degrees of the display model.", many=True),
        Degree,
        OnlyWith("experiment", ("camera-positions", "dense", "depth")),
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
        NOT_NEGATIVE,
        OnlyWith("experiment", ("camera-positions", "noise", "see-through")),
    ] = None
    stage_error_mm: Annotated[
        float | None,
        described("Camera position error of your bench in mm per axis (default: none; 0.05 in position-errors)."),
        NOT_NEGATIVE,
        OnlyWith("experiment", ("camera-positions", "position-errors")),
    ] = None
    tracking_error_mm: Annotated[
        float,
        described("Error of eye tracking in mm per axis."),
        NOT_NEGATIVE,
        OnlyWith("experiment", ("position-errors",)),
    ] = 0.05
    repeats: Annotated[
        int, described("Repetitions of each trial with random errors."), Range(at_least=1, at_most=1000)
    ] = 3
    seed: Seed = 1
    workers: Workers = None
    out: Annotated[Path, described("Output folder.")] = Path("out/evaluate")


@dataclass(frozen=True)
class Findings:
    """Result of an experiment.

    Attributes:
        blocks: tables and plots.
        verdict: sentences, one for each eye; those of the first experiment stand at the top of the report.
        advice: what to do next.
        record: data for the JSON beside tables and plots.
    """

    blocks: Sequence[Block]
    verdict: Sequence[str] = ()
    advice: Sequence[str] = ()
    record: object = None


@dataclass(frozen=True)
class Study:
    """Options and eyes of a study, and the outcomes of its trials.

    An experiment is a function of a study. It is called twice: first with `outcome_of` recording the trials that it
    needs and returning empty outcomes, then with their true outcomes.
    """

    options: EvaluateOptions
    eyes: Sequence[EvaluatedEye]
    outcome_of: Callable[[AnyTrial], Outcome]

    def display(self, eye: EvaluatedEye, kind: str, degree: int, count: int) -> Outcome:
        """The outcome of an error-free trial of the display model."""
        return self.outcome_of(trial_at(DisplayTrial, eye, kind, degree, count))

    def repeated(self, trial: DisplayTrial | SeeThroughTrial) -> list[Outcome]:
        """Outcomes of a trial's repetitions; a trial without random errors runs once."""
        times = self.options.repeats if trial.has_random_errors else 1
        return [self.outcome_of(replace(trial, repeat=k)) for k in range(times)]


def trial_at(
    trial: type[AnyOwnTrial], eye: EvaluatedEye, kind: str, degree: int, count: int, **errors: Any
) -> AnyOwnTrial:
    """A trial of an eye; `errors` are the fields of the trial that state errors of the bench."""
    where: dict[str, Any] = {"whole_panel": eye.whole_panel, "eye": eye.eye}
    return trial(eye.device, kind, degree, count, eye.eye_box_mm, **where, **errors)


def pooled(outcomes: Sequence[Outcome], measure: Measure) -> float:
    """Root mean square over repetitions of equal size."""
    return float(np.sqrt(np.mean([outcome.rms(measure) ** 2 for outcome in outcomes])))


def pooled_cell(outcomes: Sequence[Outcome], measure: Measure) -> Cell:
    """`pooled` for a table, or why there is no model."""
    return outcomes[0].refused or pooled(outcomes, measure)


def spread_note(groups: Sequence[Sequence[Outcome]], measure: Measure) -> str:
    """How much repetitions differ, in words."""
    repeated = [[outcome.rms(measure) for outcome in group] for group in groups if len(group) > 1]
    if not repeated:
        return "Random errors were drawn once: raise the number of repetitions to see the spread."
    worst = max(np.std(values, ddof=1) / np.mean(values) for values in repeated)
    return f"Over {len(repeated[0])} repetitions each rms varies by at most {100 * worst:.2g} % (standard deviation)."
