"""The two-view benchmark on the published captures; skipped where they are not at hand."""

import json
import re
from collections.abc import Callable
from pathlib import Path

import pytest
from present import present

from benchmarks.__main__ import main


@pytest.mark.slow
def test_display_captures_of_a_headset_support_a_bundle_of_rays(
    measured_data: Callable[[str], Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source = measured_data("northstar_vcam_graycode") / "session2_head"
    assert main(["published-data", "two-views", str(source), "--out", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    assert "Which model the captures support" in printed
    share = re.search(r"the rig's, ([0-9.]+) % of the mean square", printed)
    assert 0.0 < float(present(share)[1]) < 0.5  # 1.8' +- 0.5' of 32.6'
    rows = json.loads((tmp_path / "published-data.json").read_text())["tables"][0]["rows"]
    for ignored, point, bundle in (rows[:3], rows[3:]):
        assert ignored["over noise"] > 30
        assert point["over noise"] > 5
        assert bundle["over noise"] < 1.5
