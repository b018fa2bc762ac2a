"""Times in real time: tables have their rows, and figures say what the times say."""

import numpy as np
import pytest
from speed_work import needs_gl, small_work

from benchmarks.speed import eye_tracking, fixed_maps, offline, stages

pytestmark = pytest.mark.gl


@pytest.fixture(scope="module")
def work(small_panel_model):
    needs_gl()
    return small_work(small_panel_model)


def milliseconds(cell):
    value, unit = cell.split()[:2]
    assert unit == "ms"
    return float(value)


@pytest.mark.slow
def test_every_stage_has_a_time(work):
    (table,) = stages.one_eye(work, "auto").tables
    assert all(milliseconds(row[1]) > 0 for row in table.rows)
    names = " ".join(row[0] for row in table.rows)
    for stage in ("begin_frame", "intermediate view", "pyrender", "nodes", "whole frame", "warp"):
        assert stage in names
    for stage in ("newer pose and pupil", "a pose for each row", "read-back", "three colours"):
        assert stage in names


def test_whole_frames_have_a_goal(work):
    usual, large = stages.both_eyes(work, "auto", (120, 110)).figures
    assert "90 x 100 each" in usual.quantity
    assert "120 x 110 each" in large.quantity
    assert (usual.goal[:7], large.goal[:7]) == ("<= 2 ms", "<= 4 ms")
    assert milliseconds(large.ours) > 0


def test_the_price_is_the_new_maps_share(monkeypatch):
    times = np.array([[13.0, 10.0], [14.0, 10.0], [24.0, 20.0]])
    monkeypatch.setattr(eye_tracking, "times_ms", lambda first, second, rounds: times)
    figure = eye_tracking.price_figure(lambda turn: None, 3)
    assert (figure.ours, figure.compared_with[:5]) == ("14 ms", "10 ms")
    assert figure.ratio.startswith("1.30 +- ")
    assert figure.is_reached is False


def test_the_price_of_a_new_map_is_told(work):
    (figure,) = eye_tracking.price(work, "auto").figures
    assert milliseconds(figure.ours) > 0


def test_ours_is_held_against_each_warp():
    times = {fixed_maps.OURS: np.full(3, 40.0), "quick": np.full(3, 20.0), "slow": np.full(3, 80.0)}
    rows = fixed_maps.warp_rows(times)
    assert [row[1] for row in rows] == ["40 ms", "20 ms", "80 ms"]
    assert [row[2].split()[0] for row in rows] == ["1.00", "2.00", "0.50"]


@pytest.mark.parametrize(("maps_ms", "is_reached"), [(50.0, True), (40.0, False)])
def test_the_warp_is_to_take_nine_tenths_of_monados(maps_ms, is_reached):
    figure = fixed_maps.warp_figure(np.full(3, 40.0), np.full(3, maps_ms))
    assert figure.is_reached is is_reached


def test_all_warps_are_timed(work):
    part = fixed_maps.warps(work, "auto")
    names = [row[0] for row in part.tables[0].rows]
    assert names[0] == fixed_maps.OURS
    assert any("remap" in name for name in names)
    with eye_tracking.Running.of(work) as on:
        has_egl = on.gl_context.backend == "egl"
    assert sum("Monado" in name for name in names) == (2 if has_egl else 0)
    assert len(part.figures) == (1 if has_egl else 0)


def test_the_offline_frame_has_two_baselines(work):
    figures = offline.raster_part(work, "auto").figures
    if len(figures) == 1:
        pytest.skip("its baselines need EGL")
    same, plain = figures
    assert "same shading" in same.compared_with
    assert "plain" in plain.compared_with
    assert same.goal == "<= 1.6"
    assert all(milliseconds(text) > 0 for text in (same.ours, same.compared_with, plain.compared_with))
