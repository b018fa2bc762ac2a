import numpy as np
import pytest

from wlr_render.errors import BadInputError
from wlr_render.gl.context import GlContext
from wlr_render.mappings import Eye, Status
from wlr_render.warp.gl_ray_maps import GlNodeSolver
from wlr_render.warp.grid import WarpGrid
from wlr_render.warp.ray_map import RayMapPlan, choose_plan, middle_axes, solve_every_pixel

pytestmark = pytest.mark.gl


def plan_of(eye: Eye, columns: int = 21, rows: int = 31, count: int | None = None) -> RayMapPlan:
    axes = middle_axes(eye)
    warp_grid = WarpGrid.edge_to_edge(eye.display.panel, columns, rows)
    return RayMapPlan.onto_grid(warp_grid, count or choose_plan(eye).node_count, axes)


def test_the_texture_holds_the_exact_rays_at_the_points(gl_context: GlContext, toy_headset: Eye) -> None:
    plan = plan_of(toy_headset)
    nodes = GlNodeSolver(gl_context, toy_headset, plan)
    for unit in ([0.0, 0.0, 0.0], [0.7, -0.9, 0.8]):
        viewpoint = toy_headset.eye_box.at(np.array(unit))
        field = nodes.solve(viewpoint)
        exact = solve_every_pixel(toy_headset, viewpoint, plan.device_from_camera, plan.warp_grid.panel_pixel())
        np.testing.assert_allclose(field.read_slope_offset(), exact.slope_offset, atol=2e-5)
        np.testing.assert_array_equal(field.read().slope_offset, field.read_slope_offset())
        assert (field.read_status() == Status.OK).all()
        assert field.warp_grid is plan.warp_grid
        np.testing.assert_array_equal(field.viewpoint_in_device, viewpoint)


def test_nodes_without_an_answer_are_filled_and_the_hole_stays(
    gl_context: GlContext, toy_headset: Eye, toy_headset_with_hole: Eye
) -> None:
    eye = toy_headset_with_hole
    plan = plan_of(eye, 49, 41, 9)
    solver = GlNodeSolver(gl_context, eye, plan)
    for unit in ([0, 0, 0], [0.8, -0.7, 0.9], [1.4, 1.2, -1]):
        viewpoint = eye.eye_box.at(np.array(unit, float))
        whole = solve_every_pixel(toy_headset, viewpoint, plan.device_from_camera, plan.warp_grid.panel_pixel())
        in_hole = solve_every_pixel(eye, viewpoint, plan.device_from_camera, plan.warp_grid.panel_pixel()).status > 0
        assert 0 < in_hole.sum() < 50
        field = solver.solve(viewpoint)
        found = field.read_slope_offset()
        np.testing.assert_array_equal(np.isnan(found).all(axis=0), in_hole)
        np.testing.assert_allclose(found[:, ~in_hole], whole.slope_offset[:, ~in_hole], atol=2e-4)
        status = field.read_status()
        assert (status[in_hole] == Status.MISS).all()
        # Points around filled nodes are counted too.
        assert in_hole.sum() <= (status == Status.MISS).sum() < 0.2 * status.size


def test_a_viewpoint_that_is_none_is_refused_and_the_field_stays(gl_context: GlContext, toy_headset: Eye) -> None:
    nodes = GlNodeSolver(gl_context, toy_headset, plan_of(toy_headset))
    field = nodes.solve(toy_headset.eye_box.centre)
    before = field.read_slope_offset()
    with pytest.raises(BadInputError, match=r"is \[0.0, nan, 0.0\]; give three finite numbers"):
        nodes.solve(np.array([0.0, np.nan, 0.0]))
    np.testing.assert_array_equal(field.read_slope_offset(), before)
