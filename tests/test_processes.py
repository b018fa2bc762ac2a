"""Work in several processes: all of it comes back, and the environment is as before."""

import contextlib
import math
import os
import signal
import subprocess
import sys
import time

import pytest

from wlr_render.processes import as_finished


def test_every_task_is_done_once_with_one_thread_each(monkeypatch):
    monkeypatch.delenv("MKL_NUM_THREADS", raising=False)
    assert sorted(as_finished(math.sqrt, [4.0, 9.0, 1.0], 2)) == [1.0, 2.0, 3.0]
    assert list(as_finished(os.getenv, ["MKL_NUM_THREADS"], 1)) == ["1"]
    assert "MKL_NUM_THREADS" not in os.environ


def test_a_fault_of_a_task_comes_back():
    with pytest.raises(ValueError, match="math domain error"):
        list(as_finished(math.sqrt, [-1.0], 1))


WORK = """
import os, sys, time
from wlr_render.processes import as_finished

def work(number):
    open(f"begun {os.getpid()}", "w").close()
    time.sleep(0.5)
    open(f"ended {number}", "w").close()

if __name__ == "__main__":
    try:
        list(as_finished(work, range(50), 2))
    except KeyboardInterrupt:
        sys.exit(130)
"""


@pytest.fixture
def working(tmp_path):
    """A session of processes with two workers at work, and their process ids."""
    (tmp_path / "work.py").write_text(WORK)
    path = os.pathsep.join([*sys.path, str(tmp_path)])
    process = subprocess.Popen(
        [sys.executable, "work.py"],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": path},
        stderr=subprocess.PIPE,
        start_new_session=True,
        # What runs the tests in the background has them ignore Ctrl-C, which a child inherits.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    assert until(lambda: len(list(tmp_path.glob("begun *"))) == 2)
    yield process, [int(each.name.split()[1]) for each in tmp_path.glob("begun *")]
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.communicate()


def until(reached):
    end = time.monotonic() + 60
    while not reached() and time.monotonic() < end:
        time.sleep(0.02)
    return reached()


def is_running(process_id):
    try:
        os.kill(process_id, 0)
    except ProcessLookupError:
        return False
    with open(f"/proc/{process_id}/stat") as stat:
        return stat.read().rsplit(")", 1)[1].split()[0] != "Z"


@pytest.mark.skipif(not os.path.isdir("/proc/self"), reason="reads /proc")
def test_workers_end_with_a_parent_that_is_killed(working):
    process, workers = working
    process.kill()
    assert until(lambda: not any(map(is_running, workers)))


@pytest.mark.skipif(os.name == "nt", reason="sends SIGINT to a group of processes")
def test_an_interrupt_lets_the_tasks_at_work_finish_and_is_silent(working, tmp_path):
    process, _ = working
    os.killpg(process.pid, signal.SIGINT)
    _, error = process.communicate(timeout=60)
    assert (process.returncode, error) == (130, b"")
    ended = len(list(tmp_path.glob("ended *")))
    assert 2 <= ended < 10
