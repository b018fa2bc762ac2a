"""Predicted covariance of registration against true errors of simulated sessions."""

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import Annotated

import numpy as np

from benchmarks.budget.trial import (
    CAMERA_FRAME,
    CONDITIONS,
    MODEL_ALONE,
    SHARES,
    BudgetOutcome,
    BudgetTrial,
    loaded_outcome,
    run_trial,
)
from benchmarks.intervals import ratio_interval
from benchmarks.kept_trials import finished_trials
from benchmarks.simulated_lab.bench_trial import DEVICES
from wlr_render.budget.statement import REGIONS
from wlr_render.io.atomic_files import output_folder, write_text
from wlr_render.jobs.options import ProgressArgument, Range, Scheduler, Seed, SpreadOptions, Workers, described
from wlr_render.report.blocks import Cell, Report, ReportTable
from wlr_render.report.save import markdown, save_report
from wlr_render.work.progress import SILENT


@dataclass(frozen=True)
class BudgetStudyOptions(SpreadOptions):
    """Options of `budget`."""

    _: KW_ONLY
    sessions: Annotated[int, described("Simulated sessions; three headsets take turns."), Range(1, 1000)] = 30
    first: Annotated[int, described("Number of the first session."), Range(0, 100_000)] = 0
    resume: Annotated[
        bool, described("Keep the sessions that an earlier run of the same program left there.", flag=True)
    ] = False
    workers: Workers = None
    scheduler: Scheduler = None
    record: Annotated[Path | None, described("Folder in which budget.md is kept, too.")] = None
    seed: Seed = 1
    out: Annotated[Path, described("Output folder.")] = Path("out/benchmarks/budget")


_DEFAULTS = BudgetStudyOptions()


def run(options: BudgetStudyOptions = _DEFAULTS, *, progress: ProgressArgument = SILENT) -> Report:
    """Simulate, calibrate, predict and compare; write budget.html, .md and .json.

    Raises:
        BadInputError: an output folder that cannot be written.
    """
    folder = output_folder(options.out)
    tasks = [BudgetTrial(options.first + number) for number in range(options.sessions)]
    finished = finished_trials(
        run_trial,
        loaded_outcome,
        tasks,
        seed=options.seed,
        folder=folder / "trials",
        resume=options.resume,
        workers=options.worker_pool,
    )
    outcomes: list[BudgetOutcome] = []
    try:
        for outcome in progress(finished, len(tasks), "sessions"):
            outcomes.append(outcome)
    finally:
        outcomes.sort(key=lambda each: each.trial.number)
        report = Report(
            f"Predicted against true registration: {len(outcomes)} of {len(tasks)} sessions",
            blocks=tables(outcomes),
            record={"options": options, "trials": outcomes},
        )
        report = save_report(report, folder, "budget")
        if options.record is not None:
            write_text(options.record / "budget.md", markdown(report, options.record))
    return report


def tables(outcomes: Sequence[BudgetOutcome]) -> list[ReportTable]:
    """Tabulate coverage by region of the panel, predicted over true rms by headset, and refused sessions."""
    by_region, by_device = [], []
    judged = [each for each in outcomes if not each.refused]
    for condition in CONDITIONS:
        by_region += [_row(condition, region, judged, regions=(region,)) for region in REGIONS]
        by_device += [
            _row(condition, device, [each for each in judged if each.trial.device == device]) for device in DEVICES
        ]
    refused: list[list[Cell]] = [
        [each.trial.number, each.trial.device, each.refused] for each in outcomes if each.refused
    ]
    notes = (
        "Ellipses of the predicted covariance; wanted: 60 to 76 and 92 to 98 % within, and 0.8 to 1.25 for predicted "
        "over true rms. Intervals: 95 %, bootstrap over sessions, because errors of one session are dependent; of a "
        "few sessions they are too narrow.",
        f"{MODEL_ALONE.capitalize()}: exact trackers, in the device's own frame. {CAMERA_FRAME.capitalize()}: exact "
        "trackers in the frame of the tracking camera as stated, without the source of that name.",
        "Trackers: sizes as `budget` takes them by default; noise with Student's t of five degrees of freedom and "
        "correlated axes, one bias a session, evenly distributed, motion with Laplace's distribution.",
        "Depths of 0.3 to 5 m, evenly in dioptres; pixels over the whole panel, viewpoints over the whole eye box.",
    )
    heads = ["condition", "", "sessions", "within 68 % (%)", "interval, 68 %", "within 95 % (%)", "interval, 95 %"]
    heads += ["rms (arcmin)", "predicted / true", "interval, predicted / true"]
    found = [
        ReportTable(f"By region of the panel, {len(judged)} sessions", heads, [row for row in by_region if row], notes),
        ReportTable("By headset", heads, [row for row in by_device if row]),
        ReportTable("Sessions that were refused", ["session", "headset", "reason"], refused),
    ]
    return [table for table in found if table.rows]


def _row(condition: str, name: str, outcomes: Sequence[BudgetOutcome], regions: Sequence[str] = REGIONS) -> list[Cell]:
    """Return a row pooled over sessions and regions; cells without data are empty."""
    sessions = [
        [part for part in each.coverage if part.condition == condition and part.region in regions] for each in outcomes
    ]
    sessions = [each for each in sessions if sum(part.points for part in each)]
    if not sessions:
        return []
    points, true, predicted = (np.array([sum(getattr(p, key) for p in each) for each in sessions]) for key in _SUMS)
    cells: list[Cell] = [condition, name, len(sessions)]
    for number in range(len(SHARES)):
        inside = np.array([sum(part.inside[number] for part in each) for each in sessions])
        low, high = ratio_interval(inside, points)
        cells += [100.0 * float(inside.sum() / points.sum()), f"{100 * low:.0f} to {100 * high:.0f}"]
    low, high = np.sqrt(ratio_interval(predicted, true))
    rms, ratio = np.sqrt(true.sum() / points.sum()), np.sqrt(predicted.sum() / true.sum())
    return [*cells, float(rms), float(ratio), f"{low:.2f} to {high:.2f}"]


_SUMS = ("points", "true", "predicted")
