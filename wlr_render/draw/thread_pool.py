"""One thread pool for the whole process; numpy, OpenCV and Embree release the GIL."""

import functools
import os
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

from wlr_render.work.workers import usable_cores

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


@functools.cache
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(usable_cores(), "wlr-render", initializer=_mark_worker)


def _mark_worker() -> None:
    _thread.is_worker = True


# A forked child has the pool but none of its threads, and would wait for them for ever.
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_pool.cache_clear)
