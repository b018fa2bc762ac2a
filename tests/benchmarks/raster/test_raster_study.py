"""`./wlr bench raster`: figures, frames and error map of rasterised against ray-traced frames."""

import json
from dataclasses import replace

import numpy as np
import pytest
from small_headsets import changed_device

from benchmarks.raster.study import RasterOptions, run
from wlr_render.errors import BadInputError
from wlr_render.jobs.headset import open_eye
from wlr_render.rendering.image_files import read_map, read_png
from wlr_render.report.blocks import Plot


@pytest.fixture(scope="module")
def headset(tmp_path_factory):
    return changed_device(tmp_path_factory.mktemp("device"), "birdbath28", ("[1920, 1080]", "[96, 54]"))


@pytest.fixture(scope="module")
def comparison(opened_gl_context, tmp_path_factory, headset, scene_file):
    """A bent headset off the centre of its eye box, before a ball that hides a part of a wall."""
    folder = tmp_path_factory.mktemp("compare")
    options = RasterOptions(headset, scene_file, viewpoint_offset_mm=(3.0, -2.0, 1.0), out=folder)
    return run(options), folder


def rows_by_method(table):
    return {row[0]: dict(zip(table.columns, row, strict=True)) for row in table.rows}


def test_each_method_of_rasterising_has_its_figures(comparison):
    rows = rows_by_method(comparison[0].tables[0])
    plain, double, mesh = rows["raster + warp"], rows["twice the raster resolution"], rows["map from the mesh"]
    assert 0 < plain["median (arcmin)"] < 0.01
    assert double["95 % (arcmin)"] <= plain["95 % (arcmin)"]
    # The map from the mesh is the ray-traced frame's own: what is left is a colour taken from the image.
    assert (mesh["max (arcmin)"], mesh["only in one (%)"]) == (0, 0)
    assert mesh["colour difference (8 bit)"] > 0
    assert all(0 <= row["disoccluded (%)"] < 2 for row in rows.values())
    assert double["colour difference (8 bit)"] < plain["colour difference (8 bit)"] < 5
    paper = rows["camera at the viewpoint, map from the mesh (paper)"]
    assert paper["max (arcmin)"] == 0
    assert paper["disoccluded (%)"] == rows["raster camera at the viewpoint"]["disoccluded (%)"]
    assert paper["colour difference (8 bit)"] != mesh["colour difference (8 bit)"]


def test_the_error_map_and_the_frames_are_what_the_table_summarises(comparison):
    report, folder = comparison
    pictures = {"raster.png", "raytrace.png", "error.tiff", "compare.png"}
    assert {path.name for path in folder.iterdir()} == pictures | {"raster.html", "raster.md", "raster.json"}
    assert sorted(report.files) == sorted(folder.iterdir())
    error = read_map(folder / "error.tiff")
    assert error.shape == (54, 96, 3)
    plain = rows_by_method(report.tables[0])["raster + warp"]
    angle, disoccluded, only_one = np.moveaxis(error, -1, 0)
    kept = np.isfinite(angle) & (disoccluded == 0)
    assert np.median(angle[kept]) == pytest.approx(plain["median (arcmin)"], rel=1e-5)
    assert angle[kept].max() == pytest.approx(plain["max (arcmin)"], rel=1e-5)
    assert set(np.unique(np.stack([disoccluded, only_one]))) <= {0, 1}
    shown = np.isfinite(angle).sum() + only_one.sum()
    assert 100 * disoccluded.sum() / shown == pytest.approx(plain["disoccluded (%)"])
    raster, traced = (read_png(folder / f"{name}.png").astype(int) for name in ("raster", "raytrace"))
    assert np.abs(raster - traced).mean() == pytest.approx(plain["colour difference (8 bit)"])
    assert read_png(folder / "compare.png").std() > 10


def test_the_report_says_from_where_and_what_came_out(comparison, headset):
    report, folder = comparison
    record = json.loads((folder / "raster.json").read_text())
    centre = open_eye(headset).eye_box.centre
    np.testing.assert_allclose(record["viewpoint_in_device_m"]["right"], centre + [0.003, -0.002, 0.001])
    assert len(record["tables"][0]["rows"]) == 5
    assert record["provenance"]["inputs"][0]["name"] == headset
    plain = rows_by_method(report.tables[0])["raster + warp"]
    assert f"{plain['median (arcmin)']:.3g}' off in the median" in report.verdict
    assert f"{plain['disoccluded (%)']:.3g} % of its pixels are disoccluded" in report.verdict


def test_the_error_plot_shows_the_error_map(comparison):
    report, folder = comparison
    (plot,) = [block for block in report.blocks if isinstance(block, Plot)]
    angle = read_map(folder / "error.tiff")[..., 0]
    np.testing.assert_allclose(plot.data[0]["customdata"], angle, rtol=1e-3, atol=1e-12)
    assert np.nanmax(plot.data[0]["z"]) == pytest.approx(np.log10(np.nanmax(angle)), abs=1e-3)


def test_without_opengl_there_is_nothing_to_compare(straight_device, scene_file, tmp_path):
    with pytest.raises(BadInputError, match=r"no raster frames to compare with --backend cpu, .*; leave --backend out"):
        run(RasterOptions(straight_device, scene_file, backend="cpu", out=tmp_path / "out"))
    assert not (tmp_path / "out").exists()


def test_without_optics_both_eyes_and_all_methods_show_the_same_points(
    gl_context, straight_device, scene_file, tmp_path
):
    report = run(RasterOptions(straight_device, scene_file, eye="both", out=tmp_path))
    assert len(report.tables) == 2
    for table in report.tables:
        rows = rows_by_method(table)
        assert all(row["max (arcmin)"] < 0.001 for row in rows.values())
        assert all(row["only in one (%)"] == 0 for row in rows.values())
        assert all(row["disoccluded (%)"] == 0 for row in rows.values())
    drawn = [read_png(tmp_path / eye / "raster.png") for eye in ("left", "right")]
    assert drawn[0].shape == drawn[1].shape


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (
            {"viewpoint_offset_mm": (0.0, 4.5, 0.0)},
            r"--viewpoint-offset-mm: the viewpoint \(0\.00, 4\.50, 0\.00\) mm lies",
        ),
        ({"scene": "desc"}, "Did you mean desk"),
        ({"headset": "missing.json"}, r"missing\.json: there is no such file"),
        ({"eye": "left", "headset": "no_optics"}, "no left eye"),
    ],
    ids=str,
)
def test_faults_are_refused_before_anything_is_written(straight_device, scene_file, tmp_path, change, sentence):
    options = RasterOptions(straight_device, scene_file, out=tmp_path / "out")
    with pytest.raises(BadInputError, match=sentence):
        run(replace(options, **change))
    assert not (tmp_path / "out").exists()
