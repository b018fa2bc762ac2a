import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from wlr_render.errors import BadInputError
from wlr_render.jobs import demo as alignment_demo
from wlr_render.jobs.demo import METHODS, Options, judged_viewpoints, simulated_captures
from wlr_render.jobs.headset import open_eye
from wlr_render.rendering.image_files import read_png


@pytest.fixture(scope="module")
def demo(tmp_path_factory, small_northstar):
    """The main job on a small panel: its result, and its folder."""
    folder = tmp_path_factory.mktemp("demo")
    options = Options(small_northstar, "sculpture", viewpoints=5, backend="cpu", out=folder)
    return alignment_demo.run(options), folder


def overall(result):
    """By method: median, 95 % and maximum in arcminutes, and the number of points."""
    return {row[0]: row[1:] for row in result.tables[0].rows}


@pytest.mark.slow
def test_only_the_methods_that_know_the_pupil_land_on_the_object(demo):
    found = overall(demo[0])
    assert tuple(found) == METHODS
    naive, static, raster, traced = (found[method] for method in METHODS)
    for statistic in (0, 1):
        assert naive[statistic] > static[statistic] > 10 * raster[statistic]
    assert raster[1] < 1.5
    assert traced[1] < 1.5
    assert raster[0] == pytest.approx(traced[0], rel=0.02)
    # Each point of the grid of 48 x 54 that shows the scene is judged, at every viewpoint.
    assert all(500 * 5 < row[3] <= 48 * 54 * 5 for row in found.values())


def test_the_static_map_is_right_at_its_own_viewpoint_alone(demo):
    by_viewpoint = [dict(zip(("viewpoint", *METHODS), row, strict=True)) for row in demo[0].tables[1].rows]
    assert len(by_viewpoint) == 5
    assert by_viewpoint[0]["static"] < 1
    assert all(row["static"] > 10 for row in by_viewpoint[1:])
    assert all(row["raster + warp"] < 1 for row in by_viewpoint)


def test_pictures_and_tables_are_written(demo, small_northstar):
    result, folder = demo
    stems = ["naive", "static", "raster-warp", "ray-traced"]
    pictures = ["alignment", "eye-display-off", *(f"{kind}-{stem}" for kind in ("panel", "eye") for stem in stems)]
    names = [f"{name}.png" for name in pictures] + ["misalignment.md", "misalignment.json"]
    assert sorted(path.name for path in folder.iterdir()) == sorted(names)
    panels = [read_png(folder / f"panel-{stem}.png") for stem in stems]
    assert all(panel.shape == (200, 180, 3) for panel in panels)
    views = [read_png(folder / f"eye-{stem}.png") for stem in ("display-off", *stems)]
    assert len({view.shape for view in views}) == 1
    assert result.picture == folder / "alignment.png"
    height, width = read_png(result.picture).shape[:2]
    assert width > 2000
    assert height > 800
    record = json.loads((folder / "misalignment.json").read_text())
    assert (record["device"], record["seed"]) == ("northstar", 1)
    rows = record["tables"][0]["rows"]
    assert [row["median (arcmin)"] for row in rows] == [row[1] for row in result.tables[0].rows]
    assert result.tables[1].markdown() in (folder / "misalignment.md").read_text()


def test_in_the_eyes_picture_the_twin_lies_on_the_object_only_where_the_pupil_is_known(demo):
    """The twin glows green; where it is right, its green follows the brightness of the real object."""
    folder = demo[1]
    real = cv2.cvtColor(read_png(folder / "eye-display-off.png"), cv2.COLOR_RGB2GRAY).astype(float)
    alike = {}
    for stem in ("naive", "static", "raster-warp", "ray-traced"):
        seen = read_png(folder / f"eye-{stem}.png").astype(float)
        twin = seen[..., 1] - seen[..., 0]  # the real object is nearly grey, the twin has no red
        alike[stem] = np.corrcoef(twin.ravel(), real.ravel())[0, 1]
    assert min(alike["raster-warp"], alike["ray-traced"]) > max(alike["naive"], alike["static"]) + 0.1


@pytest.mark.slow
def test_the_same_seed_gives_the_same_tables(demo, small_northstar, tmp_path):
    again = alignment_demo.run(Options(small_northstar, "sculpture", viewpoints=5, backend="cpu", out=tmp_path))
    assert again.tables == demo[0].tables
    for name in ("misalignment.json", "panel-raster-warp.png", "eye-static.png"):
        assert (tmp_path / name).read_bytes() == (demo[1] / name).read_bytes()


def test_another_seed_gives_other_captures(straight_device):
    truth = open_eye(straight_device)
    first, same, other = (simulated_captures(truth, seed).display.view_dir for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, same)
    assert np.abs(first - other).max() > 1e-5


def test_judged_viewpoints_are_the_centre_then_others_in_the_box(straight_device):
    truth = open_eye(straight_device)
    places = judged_viewpoints(truth, 9)
    assert places.shape == (9, 3)
    np.testing.assert_array_equal(places[0], truth.eye_box.centre)
    assert truth.eye_box.contains(places).all()
    assert len(np.unique(places, axis=0)) == 9
    np.testing.assert_array_equal(places[:5], judged_viewpoints(truth, 5))


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (Options(viewpoints=4), "--viewpoints is 4; a statement about the eye box needs 5 or more"),
        (Options(device="nothstar"), "Did you mean northstar"),
        (Options(scene="sculptur"), "Did you mean sculpture"),
        (Options(device="no_optics", eye="left"), "no left eye"),
    ],
)
def test_faults_are_refused_before_anything_is_written(options, sentence, tmp_path):
    from dataclasses import replace

    with pytest.raises(BadInputError, match=sentence):
        alignment_demo.run(replace(options, out=Path(tmp_path / "out")))
    assert not (tmp_path / "out").exists()
