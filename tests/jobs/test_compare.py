import json
from dataclasses import replace

import numpy as np
import pytest

from wlr_render.errors import BadInputError
from wlr_render.jobs import compare
from wlr_render.jobs.compare import Options
from wlr_render.jobs.headset import open_eye
from wlr_render.rendering.image_files import read_map, read_png


@pytest.fixture(scope="module")
def comparison(tmp_path_factory, model_file, scene_file):
    """A bent headset off the centre of its eye box, before a ball that hides a part of a wall."""
    folder = tmp_path_factory.mktemp("compare")
    options = Options(model_file, scene_file, viewpoint_offset_mm=(3.0, -2.0, 1.0), backend="cpu", out=folder)
    return compare.run(options), folder


def test_each_way_to_rasterise_has_its_figures(comparison):
    table = comparison[0].table
    rows = {row[0]: dict(zip(table.columns, row, strict=True)) for row in table.rows}
    plain, double, mesh = rows["raster + warp"], rows["twice the raster resolution"], rows["map from the mesh"]
    assert 0 < plain["median (arcmin)"] < 0.01
    assert double["95 % (arcmin)"] <= plain["95 % (arcmin)"]
    # The map from the mesh is the ray-traced frame's own: what is left is a colour taken from the image.
    assert (mesh["max (arcmin)"], mesh["only in one (%)"]) == (0, 0)
    assert mesh["colour difference (8 bit)"] > 0
    assert all(0 <= row["disoccluded (%)"] < 2 for row in rows.values())
    assert double["colour difference (8 bit)"] < plain["colour difference (8 bit)"] < 5


def test_the_error_map_and_the_frames_are_what_the_table_summarises(comparison):
    result, folder = comparison
    names = {path.name for path in folder.iterdir()}
    assert names == {"raster.png", "raytrace.png", "error.tiff", "compare.md", "compare.json", "compare.png"}
    error = read_map(folder / "error.tiff")
    assert error.shape == (100, 90, 3)
    plain = dict(zip(result.table.columns, result.table.rows[0], strict=True))
    angle, disoccluded, only_one = np.moveaxis(error, -1, 0)
    kept = np.isfinite(angle) & (disoccluded == 0)
    assert np.median(angle[kept]) == pytest.approx(plain["median (arcmin)"], rel=1e-5)
    assert angle[kept].max() == pytest.approx(plain["max (arcmin)"], rel=1e-5)
    assert set(np.unique(np.stack([disoccluded, only_one]))) <= {0, 1}
    shown = np.isfinite(angle).sum() + only_one.sum()
    assert 100 * disoccluded.sum() / shown == pytest.approx(plain["disoccluded (%)"])
    raster, traced = (read_png(folder / f"{name}.png").astype(int) for name in ("raster", "raytrace"))
    assert np.abs(raster - traced).mean() == pytest.approx(plain["colour difference (8 bit)"])
    assert read_png(result.picture).std() > 10


def test_the_report_says_from_where(comparison, model_file):
    record = json.loads((comparison[1] / "compare.json").read_text())
    centre = open_eye(model_file).eye_box.centre
    np.testing.assert_allclose(record["viewpoint_in_device_m"], centre + [0.003, -0.002, 0.001])
    assert len(record["tables"][0]["rows"]) == 4


def test_without_optics_both_ways_show_the_same_points(straight_device, scene_file, tmp_path):
    table = compare.run(Options(straight_device, scene_file, backend="cpu", out=tmp_path)).table
    rows = {row[0]: dict(zip(table.columns, row, strict=True)) for row in table.rows}
    assert all(row["max (arcmin)"] < 0.001 for row in rows.values())
    assert all(row["only in one (%)"] == 0 for row in rows.values())
    assert all(row["disoccluded (%)"] == 0 for row in rows.values())


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (
            {"viewpoint_offset_mm": (0.0, 4.5, 0.0)},
            r"--viewpoint-offset-mm: the viewpoint \(0\.00, 4\.50, 0\.00\) mm lies",
        ),
        ({"scene": "desc"}, "Did you mean desk"),
        ({"headset": "missing.json"}, r"missing\.json: cannot be read"),
        ({"eye": "left", "headset": "no_optics"}, "no left eye"),
    ],
    ids=str,
)
def test_faults_are_refused_before_anything_is_written(straight_device, scene_file, tmp_path, change, sentence):
    options = Options(straight_device, scene_file, backend="cpu", out=tmp_path / "out")
    with pytest.raises(BadInputError, match=sentence):
        compare.run(replace(options, **change))
    assert not (tmp_path / "out").exists()
