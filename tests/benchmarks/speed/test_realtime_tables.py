"""Times in real time: tables have their rows, and figures say what the times say."""

import pytest
from present import present
from speed_work import needs_gl, small_work

from benchmarks.speed import eye_tracking, fixed_maps, stages
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
    assert all(milliseconds(present(row[1])) > 0 for row in table.rows)
    names = " ".join(row[0] for row in table.rows)
    for stage in ("begin_frame", "intermediate view", "pyrender", "nodes", "whole frame", "warp"):
        assert stage in names
    for stage in ("newer pose and pupil", "a pose for each row", "read-back", "three colours"):
        assert stage in names


def test_all_warps_are_timed(work: Workload) -> None:
    part = fixed_maps.warps(work, "auto")
    names = [row[0] for row in part.tables[0].rows]
    assert names[0] == fixed_maps.OURS
    assert any("remap" in present(name) for name in names)
    with eye_tracking.Running.of(work) as on:
        has_egl = on.gl_context.backend == "egl"
    assert sum("Monado" in present(name) for name in names) == (2 if has_egl else 0)
    assert len(part.figures) == (1 if has_egl else 0)
