"""Parallel tasks on the processor's cores, or on the machines of a cluster.

Not joblib: its loky prints a traceback on Ctrl-C, and its workers outlive a parent that is killed.
"""

import contextlib
import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TypeVar

from wlr_render import cluster
from wlr_render.errors import BadInputError

Task = TypeVar("Task")
Result = TypeVar("Result")

_GRACE_S = 1.0
"""Time for an abandoned task to remove its temporary files."""


@dataclass(frozen=True)
class WorkerPool:
    """The processes or machines that run tasks.

    Attributes:
        processes: number of processes of this machine, or None for one per usable core.
        scheduler: address of a Dask scheduler, e.g. "tcp://host:8786", whose workers run the tasks instead.
    """

    processes: int | None = None
    scheduler: str | None = None

    def at_most(self, processes: int) -> "WorkerPool":
        """Limit the default number of processes, for tasks that need much memory each."""
        return self if self.processes else replace(self, processes=min(usable_cores(), processes))


LOCAL = WorkerPool()
"""All usable cores."""


def as_finished(
    run: Callable[[Task], Result], tasks: Sequence[Task], workers: WorkerPool, folder: Path | None = None
) -> Iterator[Result]:
    """Yield the results of all tasks, in the order of completion.

    This returns only once the scheduler has answered; tasks begin when the first result is requested. Every process
    computes with one thread, so that the order of sums does not depend on the number of workers. Workers exit with this
    process, or when the caller stops iterating or is interrupted; running tasks are abandoned. The workers of a cluster
    finish theirs.

    Args:
        run: function of a task; it and its results must be picklable.
        tasks: arguments, in the order in which they are started.
        workers: processes or machines that run them.
        folder: folder that they write into; the machines of a cluster have to share it.

    Raises:
        BadInputError: a worker was killed, e.g. because the memory was full, or the cluster cannot run the tasks.
        MissingExtraError: there is a scheduler, and Dask is not installed.
    """
    if not tasks:
        return iter(())
    if workers.scheduler is not None:
        return cluster.as_finished_by_cluster(run, tasks, workers.scheduler, folder)
    return _as_finished_here(run, tasks, workers.processes)


def _as_finished_here(run: Callable[[Task], Result], tasks: Sequence[Task], workers: int | None) -> Iterator[Result]:
    context = multiprocessing.get_context("spawn")
    # Only this process has the write end: the workers read end-of-file when this process or the system closes it.
    watched, alive = context.Pipe(duplex=False)
    with watched, alive:
        pool = ProcessPoolExecutor(workers or usable_cores(), context, _prepare_worker, (watched,))
        try:
            with _inherited_by_workers():
                futures = [pool.submit(partial(_run_or_end, run), task) for task in tasks]
            for future in as_completed(futures):
                yield future.result()
            pool.shutdown()
        except BrokenProcessPool as error:
            raise BadInputError(
                "A worker process was ended from outside, perhaps because the memory was full; give fewer --workers."
            ) from error
        finally:
            alive.close()
            pool.shutdown(cancel_futures=True)


def usable_cores() -> int:
    """Return the cores that this process may use; one core for a worker of another process."""
    if cluster.is_cluster_worker or multiprocessing.parent_process() is not None:
        return 1
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _prepare_worker(parent: Connection) -> None:
    """Ignore Ctrl-C, which reaches every process of a terminal, and exit with the parent."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, _give_up)
    threading.Thread(target=_exit_with_parent, args=(parent,), daemon=True).start()


def _give_up(number: int, frame: object) -> None:
    raise SystemExit(128 + number)


def _exit_with_parent(parent: Connection) -> None:
    """Exit when the parent has ended or wants no more results."""
    parent.poll(None)
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(_GRACE_S)
    os._exit(1)


def _run_or_end(run: Callable[[Task], Result], task: Task) -> Result:
    try:
        return run(task)
    except SystemExit:
        os._exit(1)  # the pool would go on with the next task


@contextlib.contextmanager
def _inherited_by_workers() -> Iterator[None]:
    """Set, in a `with` block, the environment and signals that new processes inherit.

    Each gets one thread: linear algebra libraries read these variables once, when a process loads them. Ctrl-C is
    ignored, because it would print a traceback of a process that is starting.
    """
    variables = (*cluster.LIBRARY_THREADS, cluster.OPENGL_THREADS)
    before = {name: os.environ.get(name) for name in variables}
    os.environ.update(dict.fromkeys(variables, "1"))
    has_mask = hasattr(signal, "pthread_sigmask")
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT]) if has_mask else set()
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name) if value is None else os.environ.update({name: value})
        if has_mask:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)
