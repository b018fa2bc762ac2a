"""Times in real time: tables have their rows, and figures say what the times say."""

import pytest
from present import narrowed
from speed_work import needs_gl, small_work

from benchmarks.speed import eye_tracking, fixed_maps, pictures, stages
from benchmarks.speed.running import Running
from benchmarks.speed.timing import TIME_COLUMNS
from benchmarks.speed.workload import Workload
from wlr_render.mappings import Eye

pytestmark = pytest.mark.gl


@pytest.fixture(scope="module")
def work(small_panel_model: Eye) -> Workload:
    needs_gl()
    return small_work(small_panel_model)


def milliseconds(cell: str) -> float:
    value, unit = cell.split()[:2]
    assert unit == "ms"
    return float(value)


@pytest.mark.slow
def test_every_stage_has_a_time(work: Workload) -> None:
    (table,) = stages.one_eye(work, "auto").tables
    assert table.columns[1:] == TIME_COLUMNS
    for row in table.rows:
        gpu, cpu, seen = (milliseconds(narrowed(cell, str)) for cell in row[1:])
        assert gpu >= 0  # begin_frame draws nothing
        assert min(cpu, seen) > 0
    names = " ".join(narrowed(row[0], str) for row in table.rows)
    for stage in ("begin_frame", "intermediate view", "pyrender", "nodes", "whole frame", "warp"):
        assert stage in names
    for stage in ("newer pose and pupil", "a pose for each row", "read-back", "three colours"):
        assert stage in names


@pytest.mark.slow
def test_each_ratio_is_of_the_program_and_of_the_gpu(work: Workload) -> None:
    near, price = (part(work, "auto").figures for part in (pictures.near_object, eye_tracking.price))
    assert len(near) == 2 * len(pictures.OBJECTS_M)
    for figures in (near, price):
        for of_program, of_gpu in zip(figures[::2], figures[1::2], strict=True):
            assert of_gpu.quantity == f"{of_program.quantity}: GPU work"
            assert (
                min(milliseconds(each) for pair in (of_program, of_gpu) for each in (pair.ours, pair.compared_with)) > 0
            )
    for frame in stages.both_eyes(work, "auto", (90, 80)).figures:
        assert "of GPU work" in frame.compared_with
        assert "of CPU" in frame.compared_with


def test_all_warps_are_timed(work: Workload) -> None:
    part = fixed_maps.warps(work, "auto")
    names = [narrowed(row[0], str) for row in part.tables[0].rows]
    assert names[0] == fixed_maps.OURS
    assert any("remap" in name for name in names)
    with Running.of(work) as on:
        has_egl = on.gl_context.backend == "egl"
    assert sum("Monado" in name for name in names) == (2 if has_egl else 0)
    assert ["GPU work" in figure.quantity for figure in part.figures] == ([False, True] if has_egl else [])
    of_remap = next(row for row in part.tables[0].rows if "remap" in narrowed(row[0], str))
    assert of_remap[1] is None
