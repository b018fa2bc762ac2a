import os
import threading
from typing import Any

import pytest

from wlr_render.draw.thread_pool import for_blocks
from wlr_render.work.workers import usable_cores


@pytest.mark.parametrize(("total", "block"), [(0, 4), (3, 4), (4, 4), (10, 4), (7, 1)])
def test_blocks_cover_everything_once(total: int, block: int) -> None:
    seen: list[Any] = []
    lock = threading.Lock()

    def work(part: slice) -> None:
        with lock:
            seen.extend(range(part.start, part.stop))

    for_blocks(work, total, block)
    assert sorted(seen) == list(range(total))


def test_parallel_work_may_call_parallel_work() -> None:
    seen: list[Any] = []
    lock = threading.Lock()

    def inner(part: slice) -> None:
        with lock:
            seen.append(part.start)

    # More outer blocks than workers: a shared queue would wait for itself.
    outer = 4 * usable_cores()
    for_blocks(lambda _: for_blocks(inner, 3, 1), outer, 1)
    assert sorted(seen) == sorted([0, 1, 2] * outer)


def test_the_exception_of_a_block_arrives() -> None:
    def work(part: slice) -> None:
        if part.start == 3:
            raise ValueError("third")

    with pytest.raises(ValueError, match="third"):
        for_blocks(work, 6, 1)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_forked_child_gets_workers_of_its_own() -> None:
    for_blocks(lambda _: None, 8, 1)
    child = os.fork()
    if child == 0:
        for_blocks(lambda _: None, 8, 1)
        os._exit(7)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 7
