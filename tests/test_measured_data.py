"""The verbs on measured sets of others, as docs/measured-data.md shows them; skipped where the sets are not at hand."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from benchmarks.__main__ import main as benchmark
from wlr_render.cli import main


@pytest.mark.slow
def test_see_through_captures_of_a_headset_show_a_thick_plate(
    measured_data: Callable[[str], Path], tmp_path: Path
) -> None:
    session = tmp_path / "itoh"
    source = measured_data("itoh_seethrough") / "data"
    assert benchmark(["published-data", "itoh-seethrough", str(source), "--out", str(session)]) == 0
    assert main(["diagnose", str(session), "--hold-out", "--out", str(tmp_path / "found")]) == 0
    record = json.loads((tmp_path / "found" / "diagnosis.json").read_text())
    (cause,) = record["causes"]
    assert (cause["name"], record["verdict"]) == ("see_through_plate", "effect located")
    # The plate is not all that bends light here.
    assert [effect["station"] for effect in record["effects"]] == ["combiner"]
    *_, held_out, values = record["tables"]
    thickness = values["rows"][0]
    assert 0.5 < thickness["one sigma by the captures"] / thickness["one sigma by the diagnosis"] < 2.0
    captures, *distances = held_out["rows"]
    assert captures["bench as described (arcmin)"] > 5.0
    assert captures["corrected (arcmin)"] < 0.45
    assert len(distances) >= 2
    for row in distances:
        assert row["corrected (arcmin)"] < 0.15 * row["bench as described (arcmin)"]
