"""Work spread over the processor's cores.

Not joblib: on Ctrl-C its loky kills the tasks at work and prints a traceback, where this pool lets them finish.
"""

import contextlib
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from typing import TypeVar

Task = TypeVar("Task")
Result = TypeVar("Result")

_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")


def as_finished(run: Callable[[Task], Result], tasks: Sequence[Task], workers: int | None) -> Iterator[Result]:
    """Results of all tasks, in the order in which they are finished.

    Every process calculates with one thread, so that sums are taken in one order whatever the number of workers.
    Whoever stops listening, or is interrupted, waits for the tasks at work only.

    Args:
        run: what is done; it and its results go between processes.
        tasks: in the order in which they are begun.
        workers: processes, or None for one per usable core.
    """
    with _one_thread_per_process():
        context = multiprocessing.get_context("spawn")
        pool = ProcessPoolExecutor(workers or usable_cores(), mp_context=context, initializer=_prepare_worker)
        try:
            for future in as_completed([pool.submit(run, task) for task in tasks]):
                yield future.result()
        finally:
            pool.shutdown(cancel_futures=True)


def few_workers(most: int) -> int:
    """One worker per usable core, but not more than `most`: for tasks of which each takes much memory."""
    return min(usable_cores(), most)


def usable_cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _prepare_worker() -> None:
    """Leave Ctrl-C, which reaches every process of a terminal, to the parent; end with a parent that is killed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None, "this runs in a worker"
    parent.join()
    os._exit(1)


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
