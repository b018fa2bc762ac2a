import json

import pytest

from wlr_render.errors import BadInputError
from wlr_render.rendering.image_files import read_png
from wlr_render.studies import trace_device


def test_figures_and_drawing_of_an_eye_are_written(tmp_path, straight_device):
    traced = trace_device.run(straight_device, "left", tmp_path / "out")
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [
        "no_optics-left.json",
        "no_optics-left.md",
        "no_optics-left.png",
    ]
    assert read_png(traced.drawing).std() > 5
    record = json.loads((tmp_path / "out" / "no_optics-left.json").read_text())
    assert (record["device"], record["eye"]) == ("no_optics", "left")
    rows = {row["figure"]: row for row in record["tables"][0]["rows"]}
    # Without optics nothing is bent or coloured, and 1 mm is 6.9 arcmin at the panel's half metre.
    assert rows["see-through deviation at infinity"]["max (arcmin)"] < 1e-9
    assert rows["see-through colour, blue to red"]["max (arcmin)"] < 1e-9
    assert rows["pupil swim per mm in y"]["max (arcmin)"] == pytest.approx(6.875, rel=0.01)
    written = (tmp_path / "out" / "no_optics-left.md").read_text()
    assert all(table.markdown() in written for table in traced.tables)
    colours = record["tables"][1]["rows"]
    assert [row["against green"] for row in colours] == ["red", "blue"]
    assert all(row["world ray max"] < 1e-6 for row in colours)


def test_colour_comes_from_the_two_ends_of_the_spectrum(tmp_path, small_northstar):
    rows = {row[0]: row[1:] for row in trace_device.run(small_northstar, "right", tmp_path).tables[0].rows}
    mean, _, maximum = rows["see-through colour, blue to red"]
    assert 0 < mean < maximum < rows["see-through deviation at infinity"][0]


def test_an_eye_that_is_not_there_writes_nothing(tmp_path):
    with pytest.raises(BadInputError, match="no left eye"):
        trace_device.run("no_optics", "left", tmp_path / "out")
    assert not (tmp_path / "out").exists()
