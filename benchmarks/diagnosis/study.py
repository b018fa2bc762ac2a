"""Success rates and error-bar coverage of diagnoses, over simulated sessions with hidden effects."""

from collections.abc import Iterable
from dataclasses import KW_ONLY, dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
from oracle.effects import LISTED, UNLISTED

from benchmarks.diagnosis.tables import tables
from benchmarks.diagnosis.trial import DiagnosisOutcome, DiagnosisTrial, TrialKind, run_trial
from wlr_render.diagnosis.causes import CAUSES
from wlr_render.files import output_folder
from wlr_render.jobs.options import Options, ProgressArgument, Range, Seed, Workers, described
from wlr_render.processes import as_finished
from wlr_render.progress import SILENT
from wlr_render.report.blocks import Report
from wlr_render.report.save import save_report

_CLEAN = 5  # clean bench sessions for every trial of a cause: false alarms are rare
_PAIRS = 4  # of causes, likewise
_MOVED = 4  # captures that moved, likewise


@dataclass(frozen=True)
class DiagnosisOptions(Options):
    """Options of `diagnosis`."""

    _: KW_ONLY
    trials: Annotated[
        int,
        described("Trials of every cause and of every effect that no cause stands for; one of each takes minutes."),
        Range(at_least=1),
    ] = 20
    seed: Seed = 1
    workers: Workers = None
    out: Annotated[Path, described("Output folder.")] = Path("out/benchmarks/diagnosis")


_DEFAULTS = DiagnosisOptions()


def run(options: DiagnosisOptions = _DEFAULTS, *, progress: ProgressArgument = SILENT) -> Report:
    """Run all trials; writes diagnosis.html, .md and .json into `options.out`, interrupted or not."""
    folder = output_folder(options.out)
    tasks = trials(options.trials, options.seed)
    outcomes: list[DiagnosisOutcome] = []
    try:
        finished = as_finished(partial(run_trial, seed=options.seed), tasks, options.workers)
        for outcome in progress(finished, len(tasks), "trials"):
            outcomes.append(outcome)
    finally:
        outcomes.sort(key=lambda outcome: tasks.index(outcome.trial))
        record = {"trials_per_cause": options.trials, "seed": options.seed, "trials": outcomes}
        title = f"{len(outcomes)} of {len(tasks)} diagnoses where the truth is known"
        report = save_report(Report(title, blocks=tables(outcomes), record=record), folder, "diagnosis")
    return report


def trials(count: int, seed: int) -> list[DiagnosisTrial]:
    """All trials of a study, mixed so that an interrupted study has some of each."""
    rng = np.random.default_rng(seed)
    pairs = [tuple(str(name) for name in rng.choice(LISTED, 2, replace=False)) for _ in range(_PAIRS * count)]
    beside = [(str(rng.choice(LISTED)),) for _ in range(_MOVED * count)]
    return [
        trial
        for number in range(count)
        for trial in (
            *(DiagnosisTrial(TrialKind.ONE, (name,), number) for name in CAUSES),
            *(DiagnosisTrial(TrialKind.UNLISTED, (name,), number) for name in UNLISTED),
            *(DiagnosisTrial(TrialKind.CLEAN, (), _CLEAN * number + i) for i in range(_CLEAN)),
            DiagnosisTrial(TrialKind.CLEAN_RUN_TIME, (), number),
            *(DiagnosisTrial(TrialKind.TWO, pairs[i], i) for i in _share(number, _PAIRS)),
            *(DiagnosisTrial(TrialKind.MOVED, beside[i], i) for i in _share(number, _MOVED)),
        )
    ]


def _share(number: int, size: int) -> Iterable[int]:
    return range(size * number, size * (number + 1))
