"""Shared parts of simulated experiments: options, trials of an eye, and the run that writes their report."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import KW_ONLY, asdict, dataclass, fields, replace
from pathlib import Path
from typing import Annotated, Any, TypeVar

import numpy as np

from benchmarks.kept_trials import damaged_outcomes
from benchmarks.trials import (
    TEST_RAYS,
    TEST_VIEWPOINTS,
    AnyTrial,
    DisplayTrial,
    EvaluatedEye,
    Outcome,
    Trial,
    run_trials,
    truth,
)
from wlr_render.errors import BadInputError
from wlr_render.io.atomic_files import output_folder
from wlr_render.jobs.options import Eyes, Range, Scheduler, Seed, SpreadOptions, Workers, described, eyes_of
from wlr_render.optics.device_file import device_path, load_device
from wlr_render.optics.traced_mappings import traced_eye
from wlr_render.report.blocks import Block, Cell, Plot, Report, ReportTable, Section, Text
from wlr_render.report.plots import curves
from wlr_render.report.save import save_report
from wlr_render.work.progress import Progress

AnyOwnTrial = TypeVar("AnyOwnTrial", bound=Trial)
Lines = dict[str, tuple[Sequence[float], Sequence[float]]]
"""Curves by name: x and y values."""


@dataclass(frozen=True)
class StudyOptions(SpreadOptions):
    """Options of every study."""

    device: Annotated[
        tuple[str, ...],
        described("Shipped devices or device files (.toml).", name=("--devices", "--device"), many=True),
    ] = (
        "northstar",
        "freeform40",
        "birdbath28",
    )
    _: KW_ONLY
    eye: Annotated[Eyes, described("Eyes to evaluate.")] = "right"
    box: Annotated[
        tuple[float, float, float] | None,
        described("Eye box: width, height and depth in mm, e.g. 10 8 6, about the centre of the device's own one."),
        Range(above=0, at_most=1000),
    ] = None
    seed: Seed = 1
    workers: Workers = None
    scheduler: Scheduler = None
    resume: Annotated[
        bool,
        described(
            "Continue a run of the same program that was cut off: outcomes in the output folder are kept.", flag=True
        ),
    ] = False
    out: Annotated[Path, described("Output folder.")] = Path("out/benchmarks")


@dataclass(frozen=True)
class Findings:
    """Result of an experiment.

    Attributes:
        blocks: tables and plots.
        verdict: sentences, one per eye; the report starts with the verdict of the first experiment that has one.
        record: data for the JSON file in addition to tables and plots.
    """

    blocks: Sequence[Block]
    verdict: Sequence[str] = ()
    record: object = None


@dataclass(frozen=True)
class Study:
    """Eyes of a study, the outcomes of its trials, and the number of repetitions of trials with random errors."""

    eyes: Sequence[EvaluatedEye]
    outcome_of: Callable[[AnyTrial], Outcome]
    repeats: int = 1

    def display(self, eye: EvaluatedEye, kind: str, degree: int | None, count: int) -> Outcome:
        """Return the outcome of an error-free trial of the display model."""
        return self.outcome_of(trial_at(DisplayTrial, eye, kind, degree, count))

    def repeated(self, trial: Trial, most: int | None = None) -> list[Outcome]:
        """Return the outcomes of a trial's repetitions, at most `most`; a trial without random errors runs once."""
        times = min(self.repeats, most or self.repeats) if trial.has_random_errors else 1
        return [self.outcome_of(replace(trial, repeat=k)) for k in range(times)]


Experiment = Callable[[Study], Findings]
"""Function that is called twice: first to record the trials that it asks for, then with their outcomes."""


def run_study(
    title: str,
    options: StudyOptions,
    experiments: Mapping[str, Experiment],
    stem: str,
    progress: Progress,
    repeats: int = 1,
) -> Report:
    """Run named experiments and save their report; a trial that several experiments need runs once.

    Raises:
        BadInputError: an option is empty, a device is faulty or lacks the eye, or the folder cannot be written.
    """
    for each in fields(options):
        if getattr(options, each.name) == ():
            raise BadInputError(f"{each.name} is empty; give at least one.")
    eyes = _evaluated_eyes(options)
    folder = output_folder(options.out)
    needed: list[AnyTrial] = []

    def record(trial: AnyTrial) -> Outcome:
        needed.append(trial)
        return Outcome({})

    for experiment in experiments.values():
        experiment(Study(eyes, record, repeats))
    damaged = damaged_outcomes(folder / "trials", options.seed) if options.resume else []
    outcomes = run_trials(needed, options.seed, options.worker_pool, progress, folder / "trials", options.resume)
    study = Study(eyes, outcomes.__getitem__, repeats)
    found = {name: experiment(study) for name, experiment in experiments.items()}
    blocks: list[Block] = [_conditions(eyes)]
    for name, findings in found.items():
        blocks.append(Section(name.replace("-", " ").capitalize()))
        blocks += [Text("", findings.verdict)] if findings.verdict else []
        blocks += findings.blocks
    records = {name: findings.record for name, findings in found.items() if findings.record is not None}
    report = Report(
        f"{title} of {', '.join(dict.fromkeys(eye.name for eye in eyes))}",
        verdict=" ".join(next((findings.verdict for findings in found.values() if findings.verdict), ())),
        warnings=[f"{path}: was not as it was written; its trial was run again." for path in damaged],
        blocks=blocks,
        inputs=[device_path(device) for device in dict.fromkeys(options.device)],
        record={"options": asdict(options), **records},
    )
    return save_report(report, folder, stem)


def _evaluated_eyes(options: StudyOptions) -> list[EvaluatedEye]:
    found = []
    for spec in dict.fromkeys(options.device):
        device = load_device(spec)
        for eye in eyes_of(options.eye):
            width, height, depth = np.round(1e3 * traced_eye(device, eye).eye_box.size, 9).tolist()
            found.append(EvaluatedEye(spec, eye, options.box or (width, height, depth), name=device.name))
    return found


def _conditions(eyes: Sequence[EvaluatedEye]) -> ReportTable:
    rows: list[list[Cell]] = [
        [str(eye), box_text(eye.eye_box_mm), str(truth(eye).field or "whole panel")] for eye in eyes
    ]
    notes = (
        "Captures are taken and errors are stated in this field. It is a choice, and they depend on it.",
        f"Each rms is over {TEST_RAYS} rays from each of {TEST_VIEWPOINTS} random viewpoints in the eye box.",
    )
    return ReportTable("Conditions", ["eye", "eye box", "field, horizontal x vertical"], rows, notes)


def trial_at(
    trial: type[AnyOwnTrial], eye: EvaluatedEye, kind: str, degree: int | None, count: int, **errors: Any
) -> AnyOwnTrial:
    """Return a trial of an eye; `errors` are the trial's fields for errors of the bench."""
    where: dict[str, Any] = {"whole_panel": eye.whole_panel, "eye": eye.eye}
    return trial(eye.device, kind, degree, count, eye.eye_box_mm, **where, **errors)


def pooled(outcomes: Sequence[Outcome], measure: str) -> float:
    """Return the root mean square over repetitions of equal size."""
    return float(np.sqrt(np.mean([outcome.rms(measure) ** 2 for outcome in outcomes])))


def error_curves(title: str, x_title: str, lines: Lines, predicted: Lines | None = None) -> Plot:
    """Plot forward errors and predicted errors on a logarithmic scale; names are "EYE, MODEL"."""
    axes = (x_title, "forward rms (arcmin)")
    dashed = {f"{name}, predicted": points for name, points in (predicted or {}).items()}
    return curves(title, {**lines, **dashed}, axes, log_y=True, grouped=True)


def box_text(box: Sequence[float]) -> str:
    """Format edge lengths, e.g. "10 x 8 x 6 mm"."""
    return " x ".join(f"{edge:g}" for edge in box) + " mm"
