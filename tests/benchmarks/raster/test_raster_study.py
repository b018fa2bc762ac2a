"""`./wlr bench raster`: figures, frames and error map of rasterised against ray-traced frames."""

from pathlib import Path

import numpy as np
import pytest
from present import as_number, narrowed
from small_headsets import changed_device

from benchmarks.raster.study import RasterOptions, run
from wlr_render.gl.context import GlContext
from wlr_render.report.blocks import Report, ReportTable
from wlr_render.scene.image_files import read_map, read_png

Compared = tuple[Report, Path]


@pytest.fixture(scope="module")
def headset(tmp_path_factory: pytest.TempPathFactory) -> str:
    return changed_device(tmp_path_factory.mktemp("device"), "birdbath28", ("[1920, 1080]", "[96, 54]"))


@pytest.fixture(scope="module")
def comparison(
    opened_gl_context: GlContext, tmp_path_factory: pytest.TempPathFactory, headset: str, scene_file: str
) -> Compared:
    """A bent headset off the centre of its eye box, before a ball that hides a part of a wall."""
    folder = tmp_path_factory.mktemp("compare")
    options = RasterOptions(headset, scene_file, viewpoint_offset_mm=(3.0, -2.0, 1.0), out=folder)
    return run(options), folder


def rows_by_method(table: ReportTable) -> dict[str, dict[str, float]]:
    """Figures by column, the rows by method."""
    return {
        narrowed(row[0], str): dict(zip(table.columns[1:], map(as_number, row[1:]), strict=True)) for row in table.rows
    }


def test_each_method_of_rasterising_has_its_figures(comparison: Compared) -> None:
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


def test_the_error_map_and_the_frames_are_what_the_table_summarises(comparison: Compared) -> None:
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


def test_without_optics_both_eyes_and_all_methods_show_the_same_points(
    gl_context: GlContext, straight_device: str, scene_file: str, tmp_path: Path
) -> None:
    report = run(RasterOptions(straight_device, scene_file, eye="both", out=tmp_path))
    assert len(report.tables) == 2
    for table in report.tables:
        rows = rows_by_method(table)
        assert all(row["max (arcmin)"] < 0.001 for row in rows.values())
        assert all(row["only in one (%)"] == 0 for row in rows.values())
        assert all(row["disoccluded (%)"] == 0 for row in rows.values())
    drawn = [read_png(tmp_path / eye / "raster.png") for eye in ("left", "right")]
    assert drawn[0].shape == drawn[1].shape
