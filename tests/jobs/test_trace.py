import json
import re

import pytest

from wlr_render.errors import BadInputError
from wlr_render.files import resource
from wlr_render.jobs.trace import TraceOptions, trace
from wlr_render.rendering.image_files import read_png


def traced(device, folder, eye="right"):
    return trace(TraceOptions(device, eye=eye, out=folder))


def test_figures_and_drawing_of_an_eye_are_written(tmp_path, straight_device):
    report = traced(straight_device, tmp_path / "out", "left")
    names = ["no_optics-left.png", "report.html", "report.json", "report.md"]
    assert sorted(path.name for path in report.files) == names
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == names
    assert read_png(tmp_path / "out" / "no_optics-left.png").std() > 5
    record = json.loads((tmp_path / "out" / "report.json").read_text())
    rows = {row["figure"]: row for row in record["tables"][0]["rows"]}
    # Without optics nothing is bent or coloured, and 1 mm is 6.9 arcmin at the panel's half metre.
    assert rows["see-through deviation at infinity"]["max (arcmin)"] < 1e-9
    assert rows["see-through colour, blue to red"]["max (arcmin)"] < 1e-9
    assert rows["pupil swim per mm in y"]["max (arcmin)"] == pytest.approx(6.875, rel=0.01)
    colours = record["tables"][1]["rows"]
    assert [row["against green"] for row in colours] == ["red", "blue"]
    assert all(row["world ray max"] < 1e-6 for row in colours)


def test_colour_comes_from_the_two_ends_of_the_spectrum(tmp_path, small_northstar):
    rows = {row[0]: row[1:] for row in traced(small_northstar, tmp_path).tables[0].rows}
    mean, _, maximum = rows["see-through colour, blue to red"]
    assert 0 < mean < maximum < rows["see-through deviation at infinity"][0]


def test_both_eyes_are_traced_and_mirror_each_other(tmp_path, small_northstar):
    report = traced(small_northstar, tmp_path, "both")
    assert [path.suffix for path in report.files].count(".png") == 2
    left, _, right, _ = report.tables
    assert left.rows[0][1] == pytest.approx(right.rows[0][1], rel=1e-9)


def test_an_eye_that_is_not_there_writes_nothing(tmp_path):
    with pytest.raises(BadInputError, match="no left eye"):
        traced("no_optics", tmp_path / "out", "left")
    assert not (tmp_path / "out").exists()


def test_a_mirror_of_the_wrong_sign_is_warned_about(tmp_path):
    text = resource("devices", "birdbath28.toml").read_text(encoding="utf-8")
    wrong = tmp_path / "wrong.toml"
    wrong.write_text(text.replace("radius_mm = -56.0", "radius_mm = 56.0"))
    assert traced("birdbath28", tmp_path / "right").warnings == []
    (warning,) = traced(str(wrong), tmp_path / "wrong").warnings
    assert warning.startswith("Only 8% of the nominal field of the right eye meets the panel: check the sign")


def test_a_device_whose_panel_is_not_in_its_field_is_refused(tmp_path):
    text = resource("devices", "birdbath28.toml").read_text(encoding="utf-8")
    wrong = tmp_path / "wrong.toml"
    wrong.write_text(re.sub(r"field_deg = .*", "field_deg = [60, 70, 60, 70]", text))
    with pytest.raises(BadInputError, match=r"wrong\.toml: no direction of the nominal field of the right eye meets"):
        traced(str(wrong), tmp_path / "out")
    assert not (tmp_path / "out").exists()
