"""Success rates and error-bar coverage of diagnoses: simulated sessions of ordinary benches with hidden effects."""

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass, replace
from pathlib import Path
from typing import Annotated, Literal, get_args

import numpy as np
from oracle.effects import LISTED, LISTED_AT_RUN_TIME, STATION_OF, UNLISTED, UNLISTED_AT_RUN_TIME

from benchmarks.diagnosis.conditions import Condition
from benchmarks.diagnosis.tables import tables
from benchmarks.diagnosis.trial import DiagnosisOutcome, DiagnosisTrial, TrialKind, loaded_outcome, run_trial
from benchmarks.kept_trials import finished_trials
from wlr_render.diagnosis.causes import CAUSES
from wlr_render.io.atomic_files import output_folder
from wlr_render.jobs.options import ProgressArgument, Range, Scheduler, Seed, SpreadOptions, Workers, described
from wlr_render.report.blocks import Report
from wlr_render.report.save import save_report
from wlr_render.work.progress import SILENT

KindName = Literal[
    "clean",
    "clean_run_time",
    "one",
    "two",
    "three",
    "late_slip",
    "unlisted",
    "unlisted_beside",
    "moved",
    "moved_many",
]
ConditionName = Literal["white", "repeatability", "sigma_misstated", "rim", "noisy_captures", "shared", "all_of_them"]

_UNLISTED = (*UNLISTED, *UNLISTED_AT_RUN_TIME)
_COMBINED = 4  # number of pairs, triples and the like per trial of a cause
_TRIALS = "trials"
_OF_CAPTURES = (Condition.REPEATABILITY, Condition.SHARED)  # need camera positions, which run-time recordings lack


@dataclass(frozen=True)
class DiagnosisOptions(SpreadOptions):
    """Options of `diagnosis`."""

    _: KW_ONLY
    trials: Annotated[
        int,
        described(
            "Trials of every cause, of every unlisted effect, and of a clean bench of every condition; four times as"
            " many of what is combined. One of each takes minutes."
        ),
        Range(at_least=1),
    ] = 20
    kinds: Annotated[
        tuple[KindName, ...], described("What is hidden: kinds of trials to run (default: all).", many=True)
    ] = get_args(KindName)
    conditions: Annotated[
        tuple[ConditionName, ...],
        described("Conditions of the benches that the trials of each kind share evenly (default: all).", many=True),
    ] = get_args(ConditionName)
    resume: Annotated[
        bool, described("Keep the trials that an earlier run of the same program left there.", flag=True)
    ] = False
    seed: Seed = 1
    workers: Workers = None
    scheduler: Scheduler = None
    out: Annotated[Path, described("Output folder.")] = Path("out/benchmarks/diagnosis")


_DEFAULTS = DiagnosisOptions()


def run(options: DiagnosisOptions = _DEFAULTS, *, progress: ProgressArgument = SILENT) -> Report:
    """Run all trials; write diagnosis.html, .md and .json into `options.out`, even if interrupted."""
    folder = output_folder(options.out)
    tasks = trials(options)
    outcomes: list[DiagnosisOutcome] = []
    try:
        finished = finished_trials(
            run_trial,
            loaded_outcome,
            tasks,
            seed=options.seed,
            folder=folder / _TRIALS,
            resume=options.resume,
            workers=options.worker_pool,
        )
        for outcome in progress(finished, len(tasks), "trials"):
            outcomes.append(outcome)
    finally:
        outcomes.sort(key=lambda outcome: tasks.index(outcome.trial))
        record = {"trials_per_cause": options.trials, "seed": options.seed, "trials": outcomes}
        title = f"{len(outcomes)} of {len(tasks)} diagnoses where the truth is known"
        report = save_report(Report(title, blocks=tables(outcomes), record=record), folder, "diagnosis")
    return report


def trials(options: DiagnosisOptions) -> list[DiagnosisTrial]:
    """Return all trials of a study, mixed so that an interrupted study has some of each kind."""
    conditions = [Condition(name) for name in options.conditions]
    made = []
    for kind in TrialKind:
        if kind.name.lower() in options.kinds:
            # Each kind has its own generator, so that its trials do not depend on the other kinds of a run.
            rng = np.random.default_rng([options.seed, list(TrialKind).index(kind)])
            effects = _effects(kind, options.trials, len(conditions), rng)
            drawn = rng.permutation(np.resize(np.arange(len(conditions)), len(effects)))
            for number, (names, which) in enumerate(zip(effects, drawn, strict=True)):
                place = (number + 0.5) / len(effects)
                trial = DiagnosisTrial(kind, names, number, conditions[which])
                if trial.at_run_time and trial.condition in _OF_CAPTURES:
                    trial = replace(trial, condition=Condition.WHITE)
                made.append((place, trial))
    return [trial for _, trial in sorted(made, key=lambda each: each[0])]


def _effects(kind: TrialKind, count: int, conditions: int, rng: np.random.Generator) -> Sequence[tuple[str, ...]]:
    """Return the names of the effects in each trial of a kind."""
    listed = [name for name in LISTED if name in CAUSES]
    match kind:
        case TrialKind.CLEAN:
            return [()] * (count * conditions)
        case TrialKind.CLEAN_RUN_TIME:
            return [()] * count
        case TrialKind.ONE:
            names = [name for name in (*LISTED, *LISTED_AT_RUN_TIME, *_UNLISTED) if name in CAUSES]
            return [(name,) for _ in range(count) for name in names]
        case TrialKind.UNLISTED:
            return [(name,) for _ in range(count) for name in _UNLISTED if name not in CAUSES]
        case TrialKind.TWO | TrialKind.THREE:
            together = 2 if kind is TrialKind.TWO else 3
            return [_chosen(listed, together, rng) for _ in range(_COMBINED * count)]
        case TrialKind.LATE_SLIP:
            return [("headset_slip",)] * (_COMBINED * count)
        case TrialKind.UNLISTED_BESIDE:
            unlisted = [name for name in _UNLISTED if name not in CAUSES]
            return [_beside(str(rng.choice(unlisted)), rng) for _ in range(_COMBINED * count)]
        case TrialKind.MOVED:
            return [_chosen(listed, 1, rng) for _ in range(_COMBINED * count)]
        case TrialKind.MOVED_MANY:
            # Half of the trials also hide a cause; the number of captures that moved varies from trial to trial.
            return [_chosen(listed, int(rng.integers(2)), rng) for _ in range(_COMBINED * count)]


def _beside(unlisted: str, rng: np.random.Generator) -> tuple[str, str]:
    """Return an unlisted effect and a listed cause of the same kind of session at another station."""
    listed = LISTED_AT_RUN_TIME if unlisted in UNLISTED_AT_RUN_TIME else LISTED
    causes = [name for name in listed if name in CAUSES and CAUSES[name].station != STATION_OF[unlisted]]
    return unlisted, str(rng.choice(causes))


def _chosen(names: Sequence[str], count: int, rng: np.random.Generator) -> tuple[str, ...]:
    return tuple(str(name) for name in rng.choice(names, count, replace=False))
