"""The verbs on measured sets of others, as docs/measured-data.md shows them; skipped where the sets are not at hand."""

import json

from wlr_render.cli import main


def test_see_through_captures_of_a_headset_show_a_thick_plate(measured_data, tmp_path):
    session = tmp_path / "itoh"
    source = measured_data("itoh_seethrough") / "data"
    assert main(["import", "itoh-seethrough", str(source), "--out", str(session)]) == 0
    assert main(["diagnose", str(session), "--out", str(tmp_path / "found")]) == 0
    record = json.loads((tmp_path / "found" / "diagnosis.json").read_text())
    (cause,) = record["causes"]
    assert cause["name"] == "see_through_plate"
    assert record["noise"][0]["believable"]
    assert main(["hold-out", str(session), "--out", str(tmp_path / "held")]) == 0
    captures, *distances = json.loads((tmp_path / "held" / "hold-out.json").read_text())["tables"][0]["rows"]
    assert captures["bench as described (arcmin)"] > 5.0
    assert captures["extended (arcmin)"] < 0.45
    assert len(distances) >= 2
    for row in distances:
        assert row["extended (arcmin)"] < 0.15 * row["bench as described (arcmin)"]


def test_display_captures_of_a_headset_support_a_bundle_of_rays(measured_data, tmp_path, capsys):
    source = measured_data("northstar_vcam_graycode") / "session2_head"
    assert main(["viewpoints", str(source), "--out", str(tmp_path)]) == 0
    assert "Which model the captures support" in capsys.readouterr().out
    rows = json.loads((tmp_path / "viewpoints.json").read_text())["tables"][0]["rows"]
    for ignored, point, bundle in (rows[:3], rows[3:]):
        assert ignored["over noise"] > 30
        assert point["over noise"] > 5
        assert bundle["over noise"] < 1.5
