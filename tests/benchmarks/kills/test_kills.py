"""Jobs that are killed at a few moments each, and resumed."""

import os
from pathlib import Path

import pytest

from benchmarks.kills.study import KillsOptions, run
from wlr_render.io.atomic_files import resource


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="kills with a signal")
def test_a_job_that_is_killed_and_resumed_gives_the_files_of_an_undisturbed_one(tmp_path: Path) -> None:
    device = tmp_path / "device.toml"
    text = resource("devices", "no_optics.toml").read_text(encoding="utf-8")
    device.write_text(text.replace("[1280, 720]", "[160, 90]"), encoding="utf-8")
    report = run(KillsOptions(jobs=("render",), moments=2, frames=8, device=str(device), out=tmp_path / "out"))
    assert report.faults == []
    assert len(report.tables[0].rows) == 1
