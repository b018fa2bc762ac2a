import numpy as np
import pytest
from fitted_eyes import fitted_eye

from wlr_render.errors import BadInputError
from wlr_render.mappings import Status
from wlr_render.rendering.gl_ray_maps import GlNodes, GlSolve
from wlr_render.rendering.ray_map import FieldPlan, choose_plan, exact_field, middle_axes
from wlr_render.rendering.warp_grid import Lattice

pytestmark = pytest.mark.gl


def plan_of(eye, columns=21, rows=31, count=None):
    axes = middle_axes(eye)
    lattice = Lattice.edge_to_edge(eye.display.panel, columns, rows)
    return FieldPlan.to_lattice(lattice, count or choose_plan(eye).node_count, axes)


def test_the_texture_holds_the_exact_rays_at_the_points(gl_context, toy_headset):
    plan = plan_of(toy_headset)
    nodes = GlNodes(gl_context, toy_headset, plan)
    for unit in ([0.0, 0.0, 0.0], [0.7, -0.9, 0.8]):
        viewpoint = toy_headset.eye_box.at(np.array(unit))
        field = nodes.solve(viewpoint)
        exact = exact_field(toy_headset, viewpoint, plan.device_from_camera, plan.lattice.panel_pixel())
        np.testing.assert_allclose(field.read_bend(), exact.bend, atol=2e-5)
        np.testing.assert_array_equal(field.read().bend, field.read_bend())
        assert (field.read_status() == Status.OK).all()
        assert field.lattice is plan.lattice
        np.testing.assert_array_equal(field.viewpoint_in_device, viewpoint)


def test_planar_models_give_what_the_shader_finds(gl_context):
    eye = fitted_eye("northstar", 5)
    plan, viewpoint = plan_of(eye), eye.eye_box.at(np.array([0.4, -0.6, 0.8]))
    by_nodes = GlNodes(gl_context, eye, plan).solve(viewpoint)
    in_shader = GlSolve(gl_context, eye, plan.lattice, plan.device_from_camera).solve(viewpoint)
    np.testing.assert_allclose(by_nodes.read_bend(), in_shader.read_bend(), atol=3e-6)


def test_around_a_hole_every_point_is_asked_and_keeps_its_status(gl_context, toy_headset_with_hole):
    eye = toy_headset_with_hole
    plan, viewpoint = plan_of(eye, 49, 41, 9), eye.eye_box.centre
    field = GlNodes(gl_context, eye, plan).solve(viewpoint)
    exact = exact_field(eye, viewpoint, plan.device_from_camera, plan.lattice.panel_pixel())
    assert 0 < (exact.status == Status.MISS).sum() < 50
    np.testing.assert_array_equal(field.read_status(), exact.status)
    np.testing.assert_array_equal(field.read_bend(), exact.bend)


def test_a_viewpoint_that_is_none_is_refused_and_the_field_stays(gl_context, toy_headset):
    nodes = GlNodes(gl_context, toy_headset, plan_of(toy_headset))
    field = nodes.solve(toy_headset.eye_box.centre)
    before = field.read_bend()
    with pytest.raises(BadInputError, match="not three finite numbers"):
        nodes.solve(np.array([0.0, np.nan, 0.0]))
    np.testing.assert_array_equal(field.read_bend(), before)
