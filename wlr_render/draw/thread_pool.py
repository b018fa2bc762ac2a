"""One thread pool for the whole process; numpy, OpenCV and Embree release the GIL."""

import functools
import os
import threading
from collections import deque
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from typing import TypeVar

from wlr_render.work.workers import usable_cores

Result = TypeVar("Result")

_thread = threading.local()


def for_blocks(work: Callable[[slice], None], total: int, block: int) -> None:
    """Call `work` on consecutive slices of `block` items that cover `total`, on all processors.

    Inside a worker the slices run one after the other, so that parallel code may call parallel code.
    The first exception of a slice is raised here.
    """
    slices = [slice(start, min(start + block, total)) for start in range(0, total, block)]
    if len(slices) <= 1 or getattr(_thread, "is_worker", False):
        for part in slices:
            work(part)
        return
    for _ in _pool().map(work, slices):
        pass


def in_background(tasks: Iterable[Callable[[], Result]], most: int) -> Generator[Result]:
    """Yield the results of tasks in order, while the threads work on the following tasks.

    The first exception of a task, or of `tasks` after the results of all tasks before, is raised here. Then, and if the
    caller stops or is interrupted, running tasks are finished and the others are dropped.

    Args:
        tasks: tasks, generated one by one in the caller's thread.
        most: largest number of unfinished tasks; with 1, each is finished before the next one is generated.
    """
    waiting = deque[Future[Result]]()
    try:
        for future in _submitted(tasks):
            waiting.append(future)
            while waiting and (len(waiting) >= most or waiting[0].done()):
                yield waiting[0].result()
                waiting.popleft()  # only now: an interrupt of `result` leaves the task in the queue to wait for
        while waiting:
            yield waiting[0].result()
            waiting.popleft()
    finally:
        for future in waiting:
            future.cancel()
        wait(waiting)


def _submitted(tasks: Iterable[Callable[[], Result]]) -> Generator[Future[Result]]:
    """Yield the futures of tasks; an exception of `tasks` is the last one's, so that no earlier result is lost."""
    try:
        for task in tasks:
            yield _pool().submit(task)
    except Exception as error:
        failed = Future[Result]()
        failed.set_exception(error)
        yield failed


@functools.cache
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(usable_cores(), "wlr-render", initializer=_mark_worker)


def _mark_worker() -> None:
    _thread.is_worker = True


# A forked child has the pool but not its threads, and would wait for them forever.
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_pool.cache_clear)
