"""Work in several processes: all of it comes back, and the environment is as before."""

import math
import os

import pytest

from wlr_render.jobs.processes import as_finished


def test_every_task_is_done_once_with_one_thread_each(monkeypatch):
    monkeypatch.delenv("MKL_NUM_THREADS", raising=False)
    assert sorted(as_finished(math.sqrt, [4.0, 9.0, 1.0], 2)) == [1.0, 2.0, 3.0]
    assert list(as_finished(os.getenv, ["MKL_NUM_THREADS"], 1)) == ["1"]
    assert "MKL_NUM_THREADS" not in os.environ


def test_a_fault_of_a_task_comes_back():
    with pytest.raises(ValueError, match="math domain error"):
        list(as_finished(math.sqrt, [-1.0], 1))
