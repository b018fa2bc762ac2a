"""Tables of times: they have their rows, and say what the times say."""

from dataclasses import replace

import numpy as np
import pytest
from fitted_eyes import fitted_polynomial
from speed_work import ROUNDS, TRIANGLES, needs_gl, small_work

from benchmarks.speed import eye_tracking, fixed_maps, growth, stages
from wlr_render.mappings import require_planar
from wlr_render.rendering.gl_ray_maps import GlPlanarSolver
from wlr_render.rendering.ray_map import middle_axes
from wlr_render.rendering.warp_grid import WarpGrid

pytestmark = pytest.mark.gl


@pytest.fixture(scope="module")
def work(small_panel_model):
    needs_gl()
    return small_work(small_panel_model)


def milliseconds(cell):
    value, unit = cell.split()
    assert unit == "ms"
    return float(value)


def test_every_stage_has_a_time_and_whole_frames_a_goal(work):
    one_eye, both = stages.stage_tables(work, "auto", (120, 110))
    assert all(milliseconds(row[1]) > 0 for row in [*one_eye.rows, *both.rows])
    names = " ".join(row[0] for row in one_eye.rows)
    for stage in ("begin_frame", "intermediate view", "pyrender", "every pixel", "nodes", "whole frame", "warp"):
        assert stage in names
    for stage in ("newer pose and pupil", "a pose for each row", "read-back", "three colours"):
        assert stage in names
    assert [row[0] for row in both.rows] == ["whole frame, 90 x 100 per eye", "whole frame, 120 x 110 per eye"]
    assert all(row[2].startswith(goal) for row, goal in zip(both.rows, ("<= 2 ms", "<= 4 ms"), strict=True))


@pytest.mark.parametrize(("software", "goal"), [(True, "<= 1.3"), (False, "<= 1.1")])
def test_the_price_is_the_new_maps_share(monkeypatch, software, goal):
    times = np.array([[13.0, 10.0], [14.0, 10.0], [24.0, 20.0]])
    monkeypatch.setattr(eye_tracking, "times_ms", lambda first, second, rounds: times)
    row = eye_tracking.price_row("nodes", lambda turn: None, software, 3)
    assert row[:3] == ["nodes", "14 ms", "10 ms"]
    assert row[3].startswith("1.30 +- ")
    assert row[4] == goal


def test_the_price_of_both_solves_is_told(work):
    table = eye_tracking.price_table(work, "auto")
    assert [row[0] for row in table.rows] == ["nodes", "pixels"]


def test_where_the_last_solution_is_the_solution_one_evaluation_is_enough(work):
    mappings = work.mappings
    with eye_tracking.Running.of(work) as on:
        warp_grid = WarpGrid.of_pixels(mappings.display.panel)
        solve = GlPlanarSolver(on.gl_context, mappings, warp_grid, middle_axes(mappings))
        cold, warm = eye_tracking.iterations(solve, work.viewpoints, work.viewpoints)
    assert (warm.mean, warm.largest) == (1.0, 1)
    assert 1.5 < cold.mean <= cold.largest


def test_a_longer_step_needs_no_fewer_iterations(work):
    table = eye_tracking.warm_start_table(work, "auto")
    shares = [float(row[3]) for row in table.rows if row[3] is not None]
    assert len(table.rows) == 2 * len(eye_tracking.STEPS_M)
    assert 0 < shares[0] <= shares[1] <= shares[2] <= 1


def test_ours_is_held_against_each_warp(monkeypatch):
    times = np.array([[40.0, 20.0, 80.0]] * 3)
    monkeypatch.setattr(fixed_maps, "times_ms", lambda *runs, rounds: times)
    rows = fixed_maps.warp_rows(dict.fromkeys([fixed_maps.OURS, "quick", "slow"], lambda turn: None), 3)
    assert [row[1] for row in rows] == ["40 ms", "20 ms", "80 ms"]
    assert [row[2].split()[0] for row in rows] == ["1.00", "2.00", "0.50"]


def test_all_warps_are_timed(work):
    names = [row[0] for row in fixed_maps.warp_table(work, "auto").rows]
    assert names[0] == fixed_maps.OURS
    assert any("remap" in name for name in names)
    with eye_tracking.Running.of(work) as on:
        has_egl = on.gl_context.backend == "egl"
    assert sum("Monado" in name for name in names) == (2 if has_egl else 0)


def test_growth_is_over_pixels_terms_and_triangles(work, monkeypatch):
    display = require_planar(work.mappings)[0]

    def refitted(panel, display_degree):
        forward = fitted_polynomial(display.forward, display.forward.box, display_degree)
        changed = replace(display, forward=forward)
        return replace(work.mappings, display=changed)

    monkeypatch.setattr(growth, "bench_model", refitted)
    sizes = growth.Sizes((32, 64, 96), (3, 4, 5), (TRIANGLES, 2 * TRIANGLES, 4 * TRIANGLES))
    table = growth.growth_table(work, "auto", sizes)
    assert [row[1] for row in table.rows[:3]] == ["1024, 4096, 9216"] * 3
    assert [row[1] for row in table.rows[3:5]] == ["35, 70, 126"] * 2
    assert table.rows[5][1] == "2048, 3968, 7936"
    assert all("+-" in row[3] for row in table.rows)
    assert work.rounds == ROUNDS
