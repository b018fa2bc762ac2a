"""Ctrl-C and SIGTERM end the programs in one sentence and leave no file that is not whole."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from signal import Signals

import pytest

pytestmark = pytest.mark.skipif(os.name == "nt", reason="sends signals")

PROGRAMS = {
    "wlr-render": ["wlr_render", "render", "northstar", "dots", "--method", "raytrace", "--out"],
    "benchmarks": ["benchmarks", "kills", "--jobs", "render", "--frames", "300", "--out"],
}


@pytest.mark.slow
@pytest.mark.parametrize(("number", "word"), [(signal.SIGINT, "interrupted"), (signal.SIGTERM, "terminated")])
@pytest.mark.parametrize("name", PROGRAMS)
def test_a_signal_ends_a_program_in_one_sentence(tmp_path: Path, name: str, number: Signals, word: str) -> None:
    out = tmp_path / "out"
    process = subprocess.Popen(
        [sys.executable, "-m", *PROGRAMS[name], str(out)],
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        # What runs the tests in the background has them ignore Ctrl-C, which a child inherits.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    while process.poll() is None and not out.is_dir():  # the job's work has begun
        time.sleep(0.02)
    process.send_signal(number)
    printed, error = process.communicate(timeout=60)  # the render alone takes minutes
    assert (process.returncode, printed) == (128 + number, b"")
    assert error.decode() == f"{name}: {word}; finished files are kept.\n"
    assert not list(tmp_path.rglob(".*"))
