"""Registration error of simulated sessions with optimised camera positions, compared with regular grids."""

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np

from benchmarks.design.trial import DESIGNS, DesignOutcome, DesignTrial, loaded_outcome, run_trial
from benchmarks.intervals import mean_ratio
from benchmarks.kept_trials import finished_trials
from wlr_render.io.atomic_files import output_folder
from wlr_render.jobs.options import ProgressArgument, Range, Scheduler, Seed, SpreadOptions, Workers, described
from wlr_render.report.blocks import Cell, Report, ReportTable
from wlr_render.report.save import save_report
from wlr_render.work.progress import SILENT

_FEW, _MANY, _CHOSEN = DESIGNS
Headset = Literal["northstar", "freeform40", "birdbath28"]


@dataclass(frozen=True)
class DesignOptions(SpreadOptions):
    """Options of `design`."""

    _: KW_ONLY
    headsets: Annotated[tuple[Headset, ...], described("Shipped headsets, one or more.", many=True)] = (
        "northstar",
        "freeform40",
        "birdbath28",
    )
    sessions: Annotated[int, described("Simulated sessions of each headset."), Range(2, 1000)] = 8
    in_depth: Annotated[
        bool, described("Choose places before and behind the middle plane, too, as `plan --in-depth` does.", flag=True)
    ] = False
    resume: Annotated[
        bool, described("Keep the sessions that an earlier run of the same program left there.", flag=True)
    ] = False
    workers: Workers = None
    scheduler: Scheduler = None
    seed: Seed = 1
    out: Annotated[Path, described("Output folder.")] = Path("out/benchmarks/design")


def run(options: DesignOptions = DesignOptions(), *, progress: ProgressArgument = SILENT) -> Report:
    """Choose, simulate, fit and compare; write design.html, .md and .json.

    Raises:
        BadInputError: captures that do not determine a model, or an output folder that cannot be written.
    """
    folder = output_folder(options.out)
    headsets = dict.fromkeys(options.headsets)
    tasks = [DesignTrial(name, options.in_depth, number) for number in range(options.sessions) for name in headsets]
    finished = finished_trials(
        run_trial,
        loaded_outcome,
        tasks,
        seed=options.seed,
        folder=folder / "trials",
        resume=options.resume,
        workers=options.worker_pool,
    )
    outcomes = sorted(progress(finished, len(tasks), "sessions"), key=lambda each: each.trial.number)
    where = "in depth" if options.in_depth else "in the middle plane"
    report = Report(
        f"Camera places chosen {where}",
        blocks=[design_table(outcomes)],
        record={"options": options, "trials": outcomes},
    )
    return save_report(report, folder, "design")


def design_table(outcomes: Sequence[DesignOutcome]) -> ReportTable:
    """Tabulate mean errors by headset, and ratios of the chosen design to the others."""
    rows: list[list[Cell]] = []
    for headset in dict.fromkeys(each.trial.headset for each in outcomes):
        own = [each.p95 for each in outcomes if each.trial.headset == headset]
        p95 = {name: np.array([each[name] for each in own]) for name in DESIGNS}
        row: list[Cell] = [headset, len(own), *(float(np.mean(p95[name])) for name in DESIGNS)]
        for name in (_FEW, _MANY):
            ratio, low, high = mean_ratio(p95[_CHOSEN], p95[name])
            row += [ratio, f"{low:.2f} to {high:.2f}"]
        rows.append(row)
    columns = ["headset", "sessions", *DESIGNS]
    columns += [f"{_CHOSEN} / {_FEW}", f"95 % interval, {_FEW}", f"{_CHOSEN} / {_MANY}", f"95 % interval, {_MANY}"]
    notes = (
        "Registration error that 95 % of the eye box stay below, mean over sessions, arcmin; geometric mean of the "
        "ratios within sessions. The places are chosen from a pilot session; another session with the default errors "
        "of the bench is simulated with each design, fitted, and compared with the traced headset.",
    )
    return ReportTable("Errors by design", columns, rows, notes)
