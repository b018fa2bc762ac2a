import json
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from browser import needs_browser, open_page
from memo import memoised, shared_folder
from present import as_number, present
from small_headsets import changed_device

from wlr_render.calibration.fit_eye import calibrate
from wlr_render.errors import BadInputError
from wlr_render.exports.page import Page
from wlr_render.jobs import demo as job
from wlr_render.jobs.demo import METHODS, DemoOptions, demo, judged_viewpoints, simulated_captures
from wlr_render.jobs.headset import open_eye
from wlr_render.report.blocks import Cell, Picture, Plot, Report
from wlr_render.scene.image_files import read_png
from wlr_render.simulation.capture_setup import CaptureSetup


def take_few_captures(patch: pytest.MonkeyPatch, positions: int) -> None:
    """Have a demo calibrate with fewer camera positions, and a quarter of the readings at each."""
    patch.setattr(job, "CAMERA_POSITIONS", positions)
    patch.setattr(job, "CaptureSetup", partial(CaptureSetup, grid=(13, 11)))


def fit_straight_rays(patch: pytest.MonkeyPatch) -> None:
    """Have a demo of a device without optics calibrate with few positions, and models of low degrees."""
    take_few_captures(patch, 9)
    patch.setattr(Page, "write", lambda *_: iter(()))  # take seconds; `finished` has a page and the picture
    patch.setattr(job, "save_picture", lambda path, *_: path.touch() or path)
    patch.setattr(job, "calibrate", partial(calibrate, display_degree=2, see_through_degree=2))


def made(folder: Path) -> Report:
    """Judge northstar with an eighth of its pixels across and down; the report and its files are in a new folder."""
    folder.mkdir()
    device = changed_device(folder, "northstar", ("[1440, 1600]", "[180, 200]"))
    with pytest.MonkeyPatch.context() as patch:
        take_few_captures(patch, 16)
        return demo(DemoOptions(device=device, viewpoints=5, out=folder / "out"))


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> tuple[Any, Path]:
    """The main job on a small panel: its result, and its folder; nobody writes there."""
    shared = shared_folder(tmp_path_factory)
    return memoised(made, shared)(shared / "demo"), shared / "demo" / "out"


def overall_rows(report: Report) -> Sequence[Sequence[Cell]]:
    return report.tables[0].rows


def overall(report: Report) -> dict[Any, Any]:
    """By method: median, 95 % and maximum in arcminutes, and the number of points."""
    return {row[0]: row[1:] for row in report.tables[0].rows}


@pytest.mark.slow
def test_only_the_methods_that_know_the_pupil_land_on_the_object(finished: tuple[Any, Path]) -> None:
    found = overall(finished[0])
    assert tuple(found) == METHODS
    naive, static, raster, traced = (found[method] for method in METHODS)
    for statistic in (0, 1):
        assert naive[statistic] > static[statistic] > 10 * raster[statistic]
    assert raster[1] < 1.5
    assert traced[1] < 1.5
    assert raster[0] == pytest.approx(traced[0], rel=0.02)
    # Each point of the grid of 48 x 54 that shows the scene is judged, at every viewpoint.
    assert all(500 * 5 < row[3] <= 48 * 54 * 5 for row in found.values())


def test_the_static_map_is_right_at_its_own_viewpoint_alone(finished: tuple[Any, Path]) -> None:
    by_viewpoint = [dict(zip(("viewpoint", *METHODS), row, strict=True)) for row in finished[0].tables[1].rows]
    assert len(by_viewpoint) == 5
    assert by_viewpoint[0]["static"] < 1
    assert all(row["static"] > 10 for row in by_viewpoint[1:])
    assert all(row["raster + warp"] < 1 for row in by_viewpoint)


def test_pictures_and_tables_are_written(finished: tuple[Any, Path]) -> None:
    report, folder = finished
    stems = ["naive", "static", "raster-warp", "ray-traced"]
    pictures = ["alignment", "eye-display-off", *(f"{kind}-{stem}" for kind in ("panel", "eye") for stem in stems)]
    names = [f"{name}.png" for name in pictures] + ["right-page.html", "report.html", "report.md", "report.json"]
    assert sorted(path.name for path in folder.iterdir()) == sorted(names)
    assert sorted(report.files) == sorted(folder.iterdir())
    panels = [read_png(folder / f"panel-{stem}.png") for stem in stems]
    assert all(panel.shape == (200, 180, 3) for panel in panels)
    views = [read_png(folder / f"eye-{stem}.png") for stem in ("display-off", *stems)]
    assert len({view.shape for view in views}) == 1
    (picture,) = [block.path for block in report.blocks if isinstance(block, Picture)]
    assert picture == folder / "alignment.png"
    height, width = read_png(picture).shape[:2]
    assert width > 2000
    assert height > 800
    record = json.loads((folder / "report.json").read_text())
    options = record["provenance"]["options"]
    assert (Path(options["--device"]).stem, options["--seed"]) == ("northstar", 1)
    assert [row["median (arcmin)"] for row in record["tables"][0]["rows"]] == [row[1] for row in overall_rows(report)]


def test_the_verdict_has_the_figures_of_planar_static_and_naive(finished: tuple[Any, Path]) -> None:
    report = finished[0]
    figures = {row[0]: [f"{as_number(value):.3g}'" for value in row[1:4]] for row in overall_rows(report)}
    assert "sculpture on northstar, right eye: misalignment with planar models is" in report.verdict
    places = [report.verdict.index(f"{f[0]}") for f in (figures[m] for m in ("raster + warp", "static", "naive"))]
    assert places == sorted(places)
    for method in ("raster + warp", "static", "naive"):
        assert all(value in report.verdict for value in figures[method])
    assert "alignment.png" in report.advice[0]
    assert "right-page.html" in report.advice[1]


def test_the_plot_of_the_distribution_agrees_with_the_table(finished: tuple[Any, Path]) -> None:
    (plot,) = [block for block in finished[0].blocks if isinstance(block, Plot)]
    for trace, row in zip(plot.data, overall_rows(finished[0]), strict=True):
        assert trace["name"] == row[0]
        at = dict(zip(trace["y"], trace["x"], strict=True))
        np.testing.assert_allclose([at[50], at[95], at[100]], [as_number(each) for each in row[1:4]], rtol=1e-3)


def test_the_predicted_error_of_the_planar_models_is_about_the_true_one(finished: tuple[Any, Path]) -> None:
    """One calibration has one draw of the noise: its own rms differs from the expected one by some tenths."""
    table = finished[0].tables[2]
    assert list(table.columns) == ["viewpoint (mm)", "predicted", "true"]
    *rows, (name, predicted, true) = table.rows
    assert (len(rows), name) == (5, "all")
    assert 0.7 < predicted / true < 1.4
    assert all(0.5 < each[1] / each[2] < 2.0 for each in rows)


@needs_browser
def test_the_page_opens_with_its_plot(finished: tuple[Any, Path], tmp_path: Path) -> None:
    page = open_page(finished[1] / "report.html", tmp_path)
    assert (page.console, page.plots) == ([], 1)


def test_in_the_eyes_picture_the_twin_lies_on_the_object_only_where_the_pupil_is_known(
    finished: tuple[Any, Path],
) -> None:
    """The twin glows green; where it is right, its green follows the brightness of the real object."""
    folder = finished[1]
    real = cv2.cvtColor(read_png(folder / "eye-display-off.png"), cv2.COLOR_RGB2GRAY).astype(float)
    alike = {}
    for stem in ("naive", "static", "raster-warp", "ray-traced"):
        seen = read_png(folder / f"eye-{stem}.png").astype(float)
        twin = seen[..., 1] - seen[..., 0]  # the real object is nearly grey, the twin has no red
        alike[stem] = np.corrcoef(twin.ravel(), real.ravel())[0, 1]
    assert min(alike["raster-warp"], alike["ray-traced"]) > max(alike["naive"], alike["static"]) + 0.1


def test_another_seed_and_another_eye_have_other_captures(straight_device: str) -> None:
    """Without optics both eyes are the same but for their noise."""
    right, left = (open_eye(straight_device, eye) for eye in ("right", "left"))
    first, same, other = (present(simulated_captures(right, seed).display).view_dir for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, same)
    assert np.abs(first - other).max() > 1e-5
    assert np.abs(first - present(simulated_captures(left, 1).display).view_dir).max() > 1e-5


def test_judged_viewpoints_are_the_centre_then_others_in_the_box(straight_device: str) -> None:
    truth = open_eye(straight_device)
    places = judged_viewpoints(truth, 9)
    assert places.shape == (9, 3)
    np.testing.assert_array_equal(places[0], truth.eye_box.centre)
    assert truth.eye_box.contains(places).all()
    assert len(np.unique(places, axis=0)) == 9
    np.testing.assert_array_equal(places[:5], judged_viewpoints(truth, 5))


@pytest.mark.slow
def test_both_eyes_have_folders_of_their_own_and_each_alone_has_the_same_tables(
    tmp_path: Path, straight_device: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    fit_straight_rays(monkeypatch)
    both, one = tmp_path / "both", tmp_path / "one"
    report = demo(DemoOptions(device=straight_device, eye="both", viewpoints=5, out=both))
    assert {path.name for path in both.iterdir()} == {"left", "right", "report.html", "report.md", "report.json"}
    assert all((both / eye / "alignment.png").is_file() for eye in ("left", "right"))
    assert len(report.tables) == 6
    assert all(f"no_optics, {eye} eye" in report.verdict for eye in ("left", "right"))
    again = demo(DemoOptions(device=straight_device, viewpoints=5, out=one))
    assert again.tables == report.tables[3:]
    for name in ("panel-raster-warp.png", "eye-static.png"):
        assert (one / name).read_bytes() == (both / "right" / name).read_bytes()


@pytest.mark.slow
def test_without_opengl_no_row_says_that_frames_were_rasterised(
    straight_device: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fit_straight_rays(monkeypatch)
    report = demo(DemoOptions(device=straight_device, viewpoints=5, backend="cpu", out=tmp_path))
    assert list(overall(report)) == ["naive", "static", "ray traced"]
    assert list(report.tables[1].columns) == ["viewpoint (mm)", "naive", "static", "ray traced"]
    assert f"with planar models is {overall(report)['ray traced'][0]:.3g}'" in report.verdict
    assert not (tmp_path / "panel-raster-warp.png").exists()


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"scene": "sculptur"}, "Did you mean sculpture"),
        ({"device": "no_optics", "eye": "left"}, "no left eye"),
    ],
)
def test_faults_are_refused_before_anything_is_written(
    change: Mapping[str, Any], sentence: str, tmp_path: Path
) -> None:
    with pytest.raises(BadInputError, match=sentence):
        demo(DemoOptions(out=tmp_path / "out", **change))
    assert not (tmp_path / "out").exists()
