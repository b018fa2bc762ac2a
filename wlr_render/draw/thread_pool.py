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

    Inside a worker the slices are worked off one after the other, so that parallel code may call parallel code.
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
    """Yield the results of tasks in their order, while the threads work on the tasks that follow.

    The first exception of a task is raised here. Then, or if the caller stops, tasks that have begun are finished, and
    the others are dropped.

    Args:
        tasks: made one by one in the caller's thread.
        most: number of unfinished tasks with which the next one is made; 0: each is finished first.
    """
    waiting = deque[Future[Result]]()
    try:
        for task in tasks:
            waiting.append(_pool().submit(task))
            while waiting and (len(waiting) > most or waiting[0].done()):
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
    finally:
        for future in waiting:
            future.cancel()
        wait(waiting)


@functools.cache
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(usable_cores(), "wlr-render", initializer=_mark_worker)


def _mark_worker() -> None:
    _thread.is_worker = True


# A forked child has the pool but none of its threads, and would wait for them for ever.
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_pool.cache_clear)
