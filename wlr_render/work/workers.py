"""Parallel tasks on the processor's cores, or on the machines of a cluster.

joblib is not used: its loky backend prints a traceback on Ctrl-C, and its workers outlive a killed parent.
"""

import contextlib
import multiprocessing
import os
import queue
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, TypeVar

from wlr_render.errors import BadInputError
from wlr_render.io import atomic_files
from wlr_render.work import cluster

Task = TypeVar("Task")
Result = TypeVar("Result")

_GRACE_S = 1.0
"""Time for an abandoned task to remove its temporary files."""
_WORKERS_EVERY_S = 1.0
"""Interval between checks that there are workers, while no result arrives."""
_NO_WORKER_S = 120.0
"""Time for which a cluster may have no worker: a queue starts them later, a killed one is started again."""


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
    finish their running tasks, and the tasks of a lost worker are given to another one.

    Args:
        run: function of a task; the function and its results must be picklable.
        tasks: arguments, in the order in which they are started.
        workers: processes or machines that run them.
        folder: folder into which the workers write; the machines of a cluster must share it.

    Raises:
        BadInputError: a worker was killed, e.g. because the memory was full; no scheduler answers, it has no workers, a
            worker has other versions or does not see the folder, or a task ended several workers.
        MissingExtraError: a scheduler is given, and Dask is not installed.
    """
    if not tasks:
        return iter(())
    results = _results(run, tasks, workers, folder)
    next(results)
    return results


def _results(
    run: Callable[[Task], Result], tasks: Sequence[Task], workers: WorkerPool, folder: Path | None
) -> Iterator[Any]:
    """Yield None once the scheduler answers, before any task begins, then each result."""
    address = workers.scheduler or ""
    pool = cluster.dask_workers(address, folder) if address else _own_processes(workers.processes)
    with pool as (submit, has_workers):
        yield None
        futures = [submit(run, task) for task in tasks]
        for future in _as_completed(futures, has_workers, address):
            yield future.result()


def _as_completed(
    futures: Sequence[Future[Any]], has_workers: Callable[[], bool], address: str
) -> Iterator[Future[Any]]:
    """Yield the futures in the order of completion.

    Raises:
        BadInputError: there has been no worker for a long time.
    """
    finished: queue.SimpleQueue[Future[Any]] = queue.SimpleQueue()
    for future in futures:
        future.add_done_callback(finished.put)
    for _ in futures:
        last_seen_s = time.monotonic()
        while (ready := _next_of(finished)) is None:
            if has_workers():
                last_seen_s = time.monotonic()
            elif time.monotonic() - last_seen_s > _NO_WORKER_S:
                raise BadInputError(
                    f"--scheduler {address}: it has had no worker for {_NO_WORKER_S:.0f} s; start some with 'dask "
                    f"worker {address} --nthreads 1', and continue."
                )
        yield ready


def _next_of(finished: queue.SimpleQueue[Future[Any]]) -> Future[Any] | None:
    try:
        return finished.get(timeout=_WORKERS_EVERY_S)
    except queue.Empty:
        return None


@contextlib.contextmanager
def _own_processes(count: int | None) -> Iterator[cluster.Pool]:
    """Start processes of this machine for a `with` block; their tasks are abandoned if it ends early."""
    context = multiprocessing.get_context("spawn")
    # Only this process has the write end: the workers read end-of-file when this process or the system closes it.
    watched, alive = context.Pipe(duplex=False)
    with watched, alive:
        pool = ProcessPoolExecutor(count or usable_cores(), context, _prepare_worker, (watched,))

        def submit(run: Callable[[Any], Any], task: Any) -> Future[Any]:
            with _inherited_by_workers():
                return pool.submit(_run_or_end, run, task)

        try:
            yield submit, lambda: True
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
    if atomic_files.is_cluster_worker or multiprocessing.parent_process() is not None:
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
        os._exit(1)  # otherwise the pool would start the next task


@contextlib.contextmanager
def _inherited_by_workers() -> Iterator[None]:
    """Set, in a `with` block, the environment and signals that new processes inherit.

    Each process gets one thread: linear algebra libraries read these variables once, when a process loads them. Ctrl-C
    is ignored, because it would print a traceback of a starting process.
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
