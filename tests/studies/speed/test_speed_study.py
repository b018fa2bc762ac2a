"""The whole run, with its jobs replaced: what it writes, and what it refuses before it measures."""

import json

import pytest
from speed_work import small_work

from wlr_render.errors import BadInputError, MissingGlError
from wlr_render.evaluation.report import ReportTable
from wlr_render.rendering import gl
from wlr_render.studies.speed import study

GPU = study.Renderer("A GPU (model 5)", is_software=False)
CPU = study.Renderer("llvmpipe", is_software=True)
ROWS = ("ray_rows", "raster_rows", "map_rows", "memory_rows")
TIMED = ("price_table", "warm_start_table", "warp_table", "frozen_map_table", "growth_table")
JUDGED = ("field_table", "landing_table", "late_table")


@pytest.fixture
def jobs(monkeypatch, tmp_path, small_panel_model):
    """Every job tells its name and the rounds it was given."""
    monkeypatch.chdir(tmp_path)  # a run on a GPU keeps its figures in the checkout's docs
    told = []

    def instead(name, many=False):
        def job(first, *rest):
            told.append((name, getattr(first, "rounds", None)))
            table = ReportTable(name, ("what",), [["1"]])
            return [table] if many else table

        return job

    for name in ROWS:
        monkeypatch.setattr(study, name, lambda *given: [["a", "1", "2", 0.5, None]])
    monkeypatch.setattr(study.stages, "stage_tables", instead("stage_tables", many=True))
    for module, names in (
        (study.eye_tracking, TIMED[:2]),
        (study.fixed_maps, TIMED[2:3]),
        (study, TIMED[3:4]),
        (study.growth, TIMED[4:]),
        (study.accuracy_tables, JUDGED),
    ):
        for name in names:
            monkeypatch.setattr(module, name, instead(name))
    monkeypatch.setattr(study, "workload", lambda panel, rounds: small_work(small_panel_model).with_rounds(rounds))
    monkeypatch.setattr(study, "bench_model", lambda panel, device: small_panel_model)
    monkeypatch.setattr(study, "_renderer", lambda backend: GPU)
    return told


def test_all_tables_are_written_and_kept_by_the_renderers_name(jobs, tmp_path):
    options = study.Options(out=tmp_path / "out", record=tmp_path / "kept")
    tables = study.run(options)
    names = ["stage_tables", *TIMED, *JUDGED]
    assert [table.title for table in tables[1:]] == names
    assert tables[0].title.startswith("Offline, 90 x 100")
    assert tables[0].notes[0].startswith(GPU.name)
    written = json.loads((tmp_path / "out/bench.json").read_text(encoding="utf-8"))
    assert [each["title"] for each in written["tables"]] == [table.title for table in tables]
    kept = (tmp_path / "kept/a-gpu-model-5.md").read_text(encoding="utf-8")
    markdown = (tmp_path / "out/bench.md").read_text(encoding="utf-8")
    assert all(f"### {name}" in text for name in names for text in (kept, markdown))


@pytest.mark.parametrize(("renderer", "rounds"), [(GPU, 77), (CPU, 5)])
def test_where_a_frame_takes_a_millisecond_there_are_more_rounds(jobs, monkeypatch, tmp_path, renderer, rounds):
    monkeypatch.setattr(study, "_renderer", lambda backend: renderer)
    study.run(study.Options(out=tmp_path), extent=study.Extent(rounds=5, gpu_rounds=77))
    assert dict(jobs)["stage_tables"] == dict(jobs)["price_table"] == rounds


def test_without_opengl_what_needs_it_is_left_out(jobs, monkeypatch, tmp_path):
    monkeypatch.setattr(study, "_renderer", lambda backend: None)
    tables = study.run(study.Options(out=tmp_path))
    assert [table.title for table in tables[1:]] == ["landing_table", "late_table"]
    assert "no OpenGL" in tables[0].notes[0]


def test_figures_are_not_kept_without_a_renderers_name(jobs, monkeypatch, tmp_path):
    monkeypatch.setattr(study, "_renderer", lambda backend: None)
    with pytest.raises(BadInputError, match="no OpenGL here"):
        study.run(study.Options(out=tmp_path, record=tmp_path / "kept"))
    assert not jobs


def test_only_opengl_that_is_asked_for_by_name_is_missed(monkeypatch):
    def missing(backend):
        raise MissingGlError("none")

    monkeypatch.setattr(gl, "open_context", missing)
    assert study._renderer("auto") is None
    assert study._renderer("cpu") is None
    with pytest.raises(MissingGlError):
        study._renderer("egl")


def test_in_a_checkout_the_figures_of_a_gpu_are_kept_without_asking(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    gpu, software = study.Renderer("GPU 1", False), study.Renderer("llvmpipe", True)
    asked = study.Options(record=tmp_path / "kept")
    assert study.kept_in(study.Options(), gpu) is None
    study.BENCHMARKS.mkdir(parents=True)
    (study.BENCHMARKS / "README.md").write_text("here\n")
    assert study.kept_in(study.Options(), gpu) == study.BENCHMARKS
    assert study.kept_in(asked, gpu) == tmp_path / "kept"
    assert study.kept_in(study.Options(), software) is None
    assert study.kept_in(study.Options(), None) is None
