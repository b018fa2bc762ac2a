"""Trials spread over the processor's cores."""

from collections import defaultdict
from collections.abc import Iterable, Mapping
from functools import partial

from wlr_render.jobs.evaluate.trials import DisplayTrial, NoModelTrial, Outcome, SeeThroughTrial
from wlr_render.jobs.processes import as_finished
from wlr_render.progress import Progress

AnyTrial = DisplayTrial | SeeThroughTrial | NoModelTrial


def run_all(
    trials: Iterable[AnyTrial], seed: int, workers: int | None, progress: Progress
) -> Mapping[AnyTrial, Outcome]:
    """Run each different trial once.

    A trial's outcome depends on the seed and the trial alone: every trial seeds itself.

    Args:
        trials: repetitions are dropped.
        seed: of the study.
        workers: processes, or None for one per usable core.
        progress: told of trials as they finish.
    """
    tasks = _tasks(trials)
    finished = (pair for result in as_finished(partial(_run, seed=seed), tasks, workers) for pair in result)
    return dict(progress(finished, sum(map(len, tasks)), "trials"))


def _tasks(trials: Iterable[AnyTrial]) -> list[list[AnyTrial]]:
    """Trials that share exact captures stay together, in one process; the longest tasks first."""
    groups: dict[object, list[AnyTrial]] = defaultdict(list)
    for trial in dict.fromkeys(trials):
        groups[_captures_of(trial)].append(trial)
    return sorted(groups.values(), key=lambda group: -_cost(group))


def _captures_of(trial: AnyTrial) -> object:
    if isinstance(trial, NoModelTrial):
        return trial
    return (type(trial), trial.setting, trial.kind, trial.viewpoints)


def _cost(group: list[AnyTrial]) -> int:
    return sum(1 if isinstance(trial, NoModelTrial) else trial.viewpoints for trial in group)


def _run(task: list[AnyTrial], seed: int) -> list[tuple[AnyTrial, Outcome]]:
    return [(trial, trial.run(seed)) for trial in task]
