"""What runs is a frame, and what is kept is kept."""

from typing import Any

import numpy as np
import pytest
from speed_work import needs_gl, small_work

from benchmarks.speed.running import LATE_S, TURN_DEG_PER_S, WALK_M_PER_S, Running, later_pose
from wlr_render.mappings import Eye
from wlr_render.numerics.arrays import FloatArray
from wlr_render.warp.gl_ray_maps import GlPlanarSolver


def test_a_later_pose_is_as_late_as_its_speeds_say() -> None:
    pose = later_pose(np.eye(4))
    assert np.rad2deg(np.arccos((np.trace(pose[:3, :3]) - 1) / 2)) == pytest.approx(TURN_DEG_PER_S * LATE_S)
    assert np.linalg.norm(pose[:3, 3]) == pytest.approx(WALK_M_PER_S * LATE_S)


@pytest.mark.gl
def test_a_second_frame_in_a_round_is_the_same_without_its_solve(
    small_panel_model: Eye, monkeypatch: pytest.MonkeyPatch
) -> None:
    needs_gl()
    solved: list[FloatArray] = []
    solve = GlPlanarSolver.solve

    def noted(self: GlPlanarSolver, viewpoint: FloatArray) -> Any:
        solved.append(viewpoint)
        return solve(self, viewpoint)

    monkeypatch.setattr(GlPlanarSolver, "solve", noted)
    with Running.of(small_work(small_panel_model)) as on:
        first = on.frame(0).read()
        second = on.frame(0).read()
        third = on.frame(1).read()
    np.testing.assert_array_equal(solved, on.work.viewpoints[:2])
    np.testing.assert_array_equal(first, second)
    assert (first != third).any()
