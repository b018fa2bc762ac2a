"""Work in several processes: all of it comes back, and the environment is as before."""

import contextlib
import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Generator, Iterator
from pathlib import Path
from signal import Signals
from typing import Any

import numpy as np
import pytest

from wlr_render.errors import BadInputError
from wlr_render.work.workers import WorkerPool, as_finished, usable_cores


def test_every_task_is_done_once_with_one_thread_each(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("MKL_NUM_THREADS", raising=False)
    assert sorted(as_finished(math.sqrt, [4.0, 9.0, 1.0], WorkerPool(2))) == [1.0, 2.0, 3.0]
    assert list(as_finished(os.getenv, ["MKL_NUM_THREADS"], WorkerPool(1))) == ["1"]
    assert "MKL_NUM_THREADS" not in os.environ


def cores(_: object) -> int:
    return usable_cores()


def test_a_worker_has_one_core() -> None:
    assert list(as_finished(cores, [0], WorkerPool(1))) == [1]
    if hasattr(os, "sched_getaffinity"):
        assert usable_cores() == len(os.sched_getaffinity(0))


def test_a_fault_of_a_task_comes_back() -> None:
    with pytest.raises(ValueError, match="math domain error"):
        list(as_finished(math.sqrt, [-1.0], WorkerPool(1)))


WORK = """
import os, signal, sys, time
from wlr_render.work.workers import WorkerPool, as_finished

def work(number):
    open(f"begun {os.getpid()}", "w").close()
    try:
        time.sleep(0.1 if number < 2 else 100)
        open(f"ended {number}", "w").close()
    finally:
        open(f"left {os.getpid()} {number}", "w").close()

def stop(number, frame):
    raise KeyboardInterrupt

if __name__ == "__main__":
    signal.signal(signal.SIGTERM, stop)
    try:
        list(as_finished(work, range(50), WorkerPool(2)))
    except KeyboardInterrupt:
        sys.exit(130)
"""


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Any]:
    """Starts a session of processes with two workers, whose tasks of the third on take 100 seconds."""
    (tmp_path / "work.py").write_text(WORK)
    path = os.pathsep.join([*sys.path, str(tmp_path)])
    started = []

    def start_session() -> subprocess.Popen[bytes]:
        process = subprocess.Popen(
            [sys.executable, "work.py"],
            cwd=tmp_path,
            env=os.environ | {"PYTHONPATH": path},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            start_new_session=True,
            # What runs the tests in the background has them ignore Ctrl-C, which a child inherits.
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
        )
        started.append(process)
        return process

    yield start_session
    for process in started:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()


@pytest.fixture
def working(start: Any, tmp_path: Path) -> tuple[Any, set[int]]:
    """A session whose two workers are at tasks of 100 seconds, and their process ids."""
    process = start()
    assert until(lambda: len(list(tmp_path.glob("ended *"))) == 2)
    return process, {int(each.name.split()[1]) for each in tmp_path.glob("begun *")}


def until(reached: Callable[[], bool]) -> bool:
    end = time.monotonic() + 60
    while not reached() and time.monotonic() < end:
        time.sleep(0.02)
    return reached()


def session_of(process: subprocess.Popen[bytes]) -> set[int]:
    """Ids of the running processes of a session."""
    found = set()
    for each in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            state, _, _, session = (each / "stat").read_text().rsplit(")", 1)[1].split()[:4]
            if state != "Z" and int(session) == process.pid:
                found.add(int(each.name))
    return found


reads_proc = pytest.mark.skipif(not os.path.isdir("/proc/self"), reason="reads /proc")


@reads_proc
def test_workers_end_with_a_parent_that_is_killed(working: tuple[Any, set[int]], tmp_path: Path) -> None:
    process, workers = working
    assert workers < session_of(process)
    process.kill()
    # Whoever reads the output of a run reads to its end only when all processes that may write have ended.
    process.communicate(timeout=60)
    assert until(lambda: not session_of(process))
    assert {int(each.name.split()[1]) for each in tmp_path.glob("left *")} == workers


@reads_proc
@pytest.mark.parametrize("seed", range(3))
def test_workers_end_with_a_parent_that_is_killed_while_they_start(start: Any, seed: int) -> None:
    process = start()
    assert until(lambda: len(session_of(process)) > 1)
    time.sleep(np.random.default_rng(seed).uniform(0.0, 0.3))
    process.kill()
    process.communicate(timeout=60)
    assert until(lambda: not session_of(process))


@pytest.mark.skipif(os.name == "nt", reason="sends signals to a group of processes")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("to_all", [True, False], ids=["group", "parent"])
def test_an_interrupt_ends_the_tasks_at_work_and_is_silent(
    working: tuple[Any, set[int]], tmp_path: Path, number: Signals, to_all: bool
) -> None:
    process, workers = working
    (os.killpg if to_all else os.kill)(process.pid, number)
    out, error = process.communicate(timeout=60)  # tasks take longer
    assert (process.returncode, out, error) == (130, b"", b"")
    assert len(list(tmp_path.glob("ended *"))) == 2
    assert {int(each.name.split()[1]) for each in tmp_path.glob("left *")} == workers


def test_a_worker_that_is_killed_is_told_in_one_sentence() -> None:
    with pytest.raises(BadInputError, match=r"A worker process was ended from outside.*give fewer --workers"):
        list(as_finished(kill_itself, [0], WorkerPool(1)))


def kill_itself(_: object) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def test_a_caller_that_stops_listening_does_not_wait_for_the_tasks_at_work() -> None:
    finished = as_finished(time.sleep, [0.0, 1000.0], WorkerPool(2))
    next(finished)
    assert isinstance(finished, Generator)
    finished.close()  # the time limit of the test run is shorter
