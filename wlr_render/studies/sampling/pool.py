"""Trials spread over the processor's cores."""

import contextlib
import multiprocessing
import os
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor, as_completed

from wlr_render.studies.progress import Progress
from wlr_render.studies.sampling.trials import DisplayTrial, NoModelTrial, Outcome, SeeThroughTrial

AnyTrial = DisplayTrial | SeeThroughTrial | NoModelTrial

_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")


def run_all(
    trials: Iterable[AnyTrial], seed: int, workers: int | None, progress: Progress
) -> Mapping[AnyTrial, Outcome]:
    """Run each different trial once.

    A trial's outcome depends on the seed and the trial alone: every trial seeds itself, and every process calculates
    with one thread, so that sums are taken in one order whatever the number of workers.

    Args:
        trials: repetitions are dropped.
        seed: of the study.
        workers: processes, or None for one per usable core.
        progress: told of trials as they finish.
    """
    tasks = _tasks(trials)
    outcomes: dict[AnyTrial, Outcome] = {}
    with _one_thread_per_process():
        pool = ProcessPoolExecutor(workers or usable_cores(), mp_context=multiprocessing.get_context("spawn"))
        try:
            futures = [pool.submit(_run, task, seed) for task in tasks]
            finished = (pair for future in as_completed(futures) for pair in future.result())
            outcomes.update(progress(finished, sum(map(len, tasks)), "trials"))
        finally:
            pool.shutdown(cancel_futures=True)
    return outcomes


def usable_cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


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


@contextlib.contextmanager
def _one_thread_per_process() -> Iterator[None]:
    """Linear algebra libraries read these variables once, when a new process loads them."""
    before = {name: os.environ.get(name) for name in _ONE_THREAD}
    os.environ.update(dict.fromkeys(_ONE_THREAD, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name) if value is None else os.environ.update({name: value})
