import dataclasses

import numpy as np
import pytest
from fitted_eyes import fitted_eye

from wlr_render.errors import BadInputError
from wlr_render.mappings import QueryResult, Status
from wlr_render.rendering import ray_map
from wlr_render.rendering.cpu_ray_maps import CpuNodeSolver, CpuPixelSolver
from wlr_render.rendering.warp_grid import WarpGrid


def small_picture(eye):
    return WarpGrid.of_pixels(eye.display.panel, (18, 20))


def test_one_pixel_each_is_the_exact_field(toy_headset_with_hole):
    panel, axes = toy_headset_with_hole.display.panel, ray_map.middle_axes(toy_headset_with_hole)
    viewpoint = toy_headset_with_hole.eye_box.at(np.array([0.4, -0.2, 0.9]))
    solve = CpuPixelSolver(toy_headset_with_hole, WarpGrid.of_pixels(panel), axes)
    exact = ray_map.solve_every_pixel(toy_headset_with_hole, viewpoint, axes)
    field = solve.solve(viewpoint)
    np.testing.assert_array_equal(field.slope_offset, exact.slope_offset)
    np.testing.assert_array_equal(field.status, exact.status)


def solve_each(eye, warp_grid):
    return CpuPixelSolver(eye, warp_grid, np.eye(3))


def solve_nodes(eye, warp_grid):
    return CpuNodeSolver(eye, ray_map.RayMapPlan.onto_grid(warp_grid, 7, np.eye(3)))


@pytest.mark.parametrize("prepare", [solve_each, solve_nodes])
def test_a_warm_start_changes_nothing(prepare):
    eye = fitted_eye("northstar", 3)
    solve, viewpoint = prepare(eye, small_picture(eye)), eye.eye_box.at(np.array([0.4, -0.2, 0.9]))
    cold = solve.solve(viewpoint)
    solve.solve(viewpoint + [1e-3, 0, 0])
    warm = solve.solve(viewpoint)
    np.testing.assert_allclose(warm.slope_offset, cold.slope_offset, atol=1e-9)
    solve.forget()
    np.testing.assert_array_equal(solve.solve(viewpoint).slope_offset, cold.slope_offset)


def test_a_pixel_that_does_not_converge_has_that_status(toy_headset):
    class Unsolved:
        panel = toy_headset.display.panel

        def view_dir_of_pixel(self, pixel, viewpoint, warm_start=None):
            return QueryResult(np.full((*pixel.shape[:-1], 3), np.nan), np.full(pixel.shape[:-1], 2, np.uint8))

    eye = dataclasses.replace(toy_headset, display=Unsolved())
    field = CpuPixelSolver(eye, small_picture(eye), np.eye(3)).solve(eye.eye_box.centre)
    assert (field.status == Status.NOT_CONVERGED).all()
    assert np.isnan(field.slope_offset).all()


@pytest.mark.parametrize("prepare", [solve_each, solve_nodes])
def test_a_viewpoint_that_is_none_is_refused(prepare, toy_headset):
    with pytest.raises(BadInputError, match="not three finite numbers"):
        prepare(toy_headset, small_picture(toy_headset)).solve(np.full(3, np.nan))


def test_nodes_start_from_the_last_solution_and_give_the_planned_ray_map(toy_headset):
    starts = []

    class Recorded:
        panel = toy_headset.display.panel

        def view_dir_of_pixel(self, pixel, viewpoint, warm_start=None):
            starts.append(warm_start)
            mapped = toy_headset.display.view_dir_of_pixel(pixel, viewpoint)
            return dataclasses.replace(mapped, warm_start=mapped.value)

    eye = dataclasses.replace(toy_headset, display=Recorded())
    plan = ray_map.RayMapPlan.onto_grid(small_picture(eye), 7, np.eye(3))
    nodes, viewpoint = CpuNodeSolver(eye, plan), eye.eye_box.centre
    first = nodes.solve(viewpoint)
    nodes.solve(viewpoint)
    nodes.forget()
    nodes.solve(viewpoint)
    assert starts[0] is None
    assert starts[2] is None
    np.testing.assert_array_equal(starts[1], eye.display.view_dir_of_pixel(plan.node_pixel, viewpoint).value)
    np.testing.assert_array_equal(first.slope_offset, ray_map.ray_map(toy_headset, viewpoint, plan).slope_offset)
