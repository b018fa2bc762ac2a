import os
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from functools import partial
from typing import Any

import pytest

from wlr_render.draw.thread_pool import for_blocks, in_background
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


@pytest.mark.parametrize("most", [1, 2, 4])
def test_results_come_in_order_from_a_bounded_number_of_tasks(most: int) -> None:
    made, finished = list[int](), list[int]()
    go_on = threading.Event()

    def task(number: int) -> int:
        if number == 0 and most > 1:
            assert go_on.wait(60)
        return number

    def tasks() -> Iterator[Callable[[], int]]:
        for number in range(9):
            made.append(number)
            assert len(made) - len(finished) <= most  # this one is not yet begun
            if number == most - 1:
                go_on.set()
            yield partial(task, number)

    for result in in_background(tasks(), most):
        finished.append(result)
    assert finished == list(range(9))


def test_background_work_that_is_interrupted_finishes_begun_tasks_and_drops_the_others() -> None:
    begun, ended, slow_has_begun = list[int](), list[int](), threading.Event()

    def task(number: int) -> None:
        begun.append(number)
        if number == 2:
            raise ValueError("third")
        if number == 10:
            slow_has_begun.set()
            time.sleep(0.3)
        ended.append(number)

    def interrupted() -> Iterator[Callable[[], None]]:
        yield from (partial(task, number) for number in range(10, 40))
        assert slow_has_begun.wait(60)
        raise KeyboardInterrupt

    with pytest.raises(ValueError, match="third"):
        list(in_background((partial(task, number) for number in range(9)), 4))
    assert sorted(begun) == sorted([*ended, 2])
    with pytest.raises(KeyboardInterrupt):
        list(in_background(interrupted(), 50))
    assert 10 in ended
    assert sorted(begun) == sorted([*ended, 2])


def test_an_interrupt_while_a_result_is_awaited_waits_for_its_task(monkeypatch: pytest.MonkeyPatch) -> None:
    begun, ended = threading.Event(), threading.Event()

    def task() -> None:
        begun.set()
        time.sleep(0.3)
        ended.set()

    def interrupted(future: Future[None], timeout: float | None = None) -> None:
        assert begun.wait(60)
        raise KeyboardInterrupt

    monkeypatch.setattr(Future, "result", interrupted)
    with pytest.raises(KeyboardInterrupt):
        list(in_background([task], 1))
    assert ended.is_set()


def test_results_before_a_task_that_cannot_be_made_are_yielded() -> None:
    results = list[int]()

    def task(number: int) -> int:
        time.sleep(0.05)
        return number

    def tasks() -> Iterator[Callable[[], int]]:
        yield from (partial(task, number) for number in range(5))
        raise ValueError("sixth")

    with pytest.raises(ValueError, match="sixth"):
        results.extend(in_background(tasks(), 9))
    assert results == list(range(5))


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_forked_child_gets_workers_of_its_own() -> None:
    for_blocks(lambda _: None, 8, 1)
    child = os.fork()
    if child == 0:
        for_blocks(lambda _: None, 8, 1)
        os._exit(7)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 7
