"""When an eye's field is solved, from where, and what is said of what has no answer."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
import pytest
from warps.composing import HEAD, SMALL, Make, draw, scene, viewpoint

from benchmarks.scene_source import SceneSource
from wlr_render.mappings import DisplayMapping, Eye, Panel, QueryResult, Status
from wlr_render.numerics.arrays import FloatArray
from wlr_render.warp.composed_frame import ComposedFrame
from wlr_render.warp.gl_ray_maps import GlNodeSolver, GlPlanarSolver, GpuRayMap

pytestmark = pytest.mark.gl


@pytest.fixture
def solved_at(monkeypatch: pytest.MonkeyPatch) -> list[object]:
    """Viewpoints that any solver was asked for."""
    asked: list[object] = []

    def counting(solve: Callable[..., Any]) -> Callable[[Any, FloatArray], GpuRayMap]:
        def solve_and_count(self: Any, at: FloatArray) -> GpuRayMap:
            asked.append(np.array(at))
            field: GpuRayMap = solve(self, at)
            return field

        return solve_and_count

    for solver in (GlPlanarSolver, GlNodeSolver):
        monkeypatch.setattr(solver, "solve", counting(solver.solve))
    return asked


def slope_offset(frame: ComposedFrame) -> FloatArray:
    (field,) = frame.eyes["right"].ray_maps
    return field.read().slope_offset.astype(np.float64)


def test_a_resting_pupil_is_solved_once(compositor: Make, headset: Eye, solved_at: list[object]) -> None:
    made = compositor(headset)
    source, seen = SceneSource(made, scene()), viewpoint(headset)
    del solved_at[:]
    for _ in range(3):
        draw(made, source, HEAD, seen)
        made.compose()
        made.compose(pose=HEAD)
    asked = len(solved_at)
    assert asked == 1
    first = slope_offset(made.compose())
    made.compose(viewpoint=seen + 1e-6)
    assert len(solved_at) == 2 * asked
    made.compose()
    assert len(solved_at) == 3 * asked
    np.testing.assert_array_equal(slope_offset(made.compose()), first)


def test_a_tracker_that_writes_the_next_viewpoint_over_the_last_is_understood(
    seen: FloatArray, compositor: Make, flat_image_headset: Eye
) -> None:
    made, cold = (compositor(flat_image_headset) for _ in range(2))
    tracked, pose = seen, HEAD.copy()
    source = SceneSource(made, scene())
    draw(made, source, pose, tracked)
    before = made.compose().read()
    tracked[:], pose[:3, 3] = viewpoint(flat_image_headset, -0.8, 0.7, 0), 0.0
    np.testing.assert_array_equal(made.compose().read(), before)
    draw(made, source, HEAD, tracked)
    draw(cold, SceneSource(cold, scene()), HEAD, tracked)
    assert np.abs(made.compose().read().astype(int) - cold.compose().read()).max() <= 1


@dataclass(frozen=True)
class Troubled:
    """A display whose solve fails in the panel's left quarter, and everywhere for a pupil far to the right."""

    whole: DisplayMapping

    @property
    def panel(self) -> Panel:
        return self.whole.panel

    def view_dir_of_pixel(self, pixel: FloatArray, at: FloatArray, warm_start: object = None) -> QueryResult:
        answer, pixel = self.whole.view_dir_of_pixel(pixel, at), np.asarray(pixel)
        failed = (pixel[..., 0] < 0.25 * self.panel.width_px) | (np.asarray(at)[..., 0] > 0.0055)
        failed = np.broadcast_to(failed, answer.status.shape)
        value = np.where(failed[..., None], np.nan, answer.value)
        return QueryResult(value, np.where(failed, Status.NOT_CONVERGED, answer.status).astype(np.uint8))


@pytest.fixture
def troubled(flat_image_headset: Eye) -> Eye:
    return replace(flat_image_headset, display=cast(DisplayMapping, Troubled(flat_image_headset.display)))


def test_what_did_not_converge_is_named_counted_and_left_black(compositor: Make, troubled: Eye) -> None:
    made = compositor(troubled, background=(9, 8, 7))
    draw(made, SceneSource(made, scene()), HEAD, viewpoint(troubled))
    frame = made.compose()
    unsolved, status = frame.unsolved(), frame.status("right")
    assert set(unsolved) == {"right"}
    assert set(unsolved["right"]) == {"not converged"}
    quarter = SMALL[0] // 4
    warp_grid = made.plan("right").warp_grid.grid
    share = unsolved["right"]["not converged"] / np.prod(warp_grid.size)
    assert 0.2 < share < 0.4
    assert (frame.read()[:, : quarter - 1] == [9, 8, 7]).all()
    assert (status[:, : quarter - 1] == 3).all()
    assert (status[:, SMALL[0] // 2 :] == 0).mean() > 0.95


def test_a_pupil_for_which_nothing_converges_keeps_the_last_map_and_is_counted(compositor: Make, troubled: Eye) -> None:
    made = compositor(troubled)
    source, seen = SceneSource(made, scene()), viewpoint(troubled)
    draw(made, source, HEAD, seen)
    first = made.compose()
    expected, rays = first.read(), slope_offset(first)
    draw(made, source, HEAD, viewpoint(troubled, 0.95, 0, 0))
    blind = made.compose()
    (count,) = blind.unsolved()["right"].values()
    np.testing.assert_array_equal(slope_offset(blind), rays)
    assert count == rays[0].size
    draw(made, source, HEAD, seen)
    assert np.abs(made.compose().read().astype(int) - expected).max() <= 1
