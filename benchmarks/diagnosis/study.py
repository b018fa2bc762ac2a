"""How often a diagnosis is right and how sure it may be, over sessions in which an effect is hidden."""

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import numpy as np
from oracle.effects import LISTED, UNLISTED

from benchmarks.diagnosis.tables import tables
from benchmarks.diagnosis.trial import Kind, Outcome, Trial, run_trial
from wlr_render.diagnosis.causes import CAUSES
from wlr_render.files import output_folder, write_text
from wlr_render.jobs.processes import as_finished
from wlr_render.progress import SILENT, Progress
from wlr_render.report.blocks import ReportTable, tables_as_json

_CLEAN = 5  # clean bench sessions for every trial of a cause: false alarms are rare
_PAIRS = 4  # of causes, likewise
_MOVED = 4  # captures that moved, likewise


@dataclass(frozen=True)
class Options:
    """How much to try.

    Attributes:
        trials: of every cause and of every effect that no cause stands for.
        seed: of all random numbers.
        workers: processes; None for one per core.
        out: folder for the results.
    """

    trials: int = 20
    seed: int = 1
    workers: int | None = None
    out: Path = Path("out/benchmarks/diagnosis")


def run(options: Options, progress: Progress = SILENT) -> list[ReportTable]:
    """Run all trials; writes diagnosis.md and diagnosis.json into `options.out`, interrupted or not."""
    folder = output_folder(options.out)
    tasks = trials(options.trials, options.seed)
    outcomes: list[Outcome] = []
    try:
        finished = as_finished(partial(run_trial, seed=options.seed), tasks, options.workers)
        for outcome in progress(finished, len(tasks), "trials"):
            outcomes.append(outcome)
    finally:
        outcomes.sort(key=lambda outcome: tasks.index(outcome.trial))
        found = tables(outcomes)
        _write(folder, options, outcomes, found)
    return found


def trials(count: int, seed: int) -> list[Trial]:
    """All trials of a study, mixed so that an interrupted study has some of each."""
    rng = np.random.default_rng(seed)
    pairs = [tuple(str(name) for name in rng.choice(LISTED, 2, replace=False)) for _ in range(_PAIRS * count)]
    beside = [(str(rng.choice(LISTED)),) for _ in range(_MOVED * count)]
    return [
        trial
        for number in range(count)
        for trial in (
            *(Trial(Kind.ONE, (name,), number) for name in CAUSES),
            *(Trial(Kind.UNLISTED, (name,), number) for name in UNLISTED),
            *(Trial(Kind.CLEAN, (), _CLEAN * number + i) for i in range(_CLEAN)),
            Trial(Kind.CLEAN_RUN_TIME, (), number),
            *(Trial(Kind.TWO, pairs[i], i) for i in _share(number, _PAIRS)),
            *(Trial(Kind.MOVED, beside[i], i) for i in _share(number, _MOVED)),
        )
    ]


def _share(number: int, size: int) -> Iterable[int]:
    return range(size * number, size * (number + 1))


def _write(folder: Path, options: Options, outcomes: list[Outcome], found: list[ReportTable]) -> None:
    write_text(folder / "diagnosis.md", "\n".join(table.markdown() for table in found))
    record = tables_as_json(
        found, trials_per_cause=options.trials, seed=options.seed, trials=[asdict(outcome) for outcome in outcomes]
    )
    write_text(folder / "diagnosis.json", record)
