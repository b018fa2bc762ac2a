from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from small_headsets import changed_device

from wlr_render.geometry import directions, rays, transforms
from wlr_render.mappings import Eye, Status
from wlr_render.optics.device_file import load_device
from wlr_render.optics.traced_mappings import traced_eye
from wlr_render.warp import ray_map
from wlr_render.warp.grid import WarpGrid


def test_chosen_nodes_give_the_exact_field_within_tolerance_at_every_pixel(toy_headset: Eye) -> None:
    plan = ray_map.choose_plan(toy_headset, tolerance_px=0.005)
    viewpoint = toy_headset.eye_box.at(np.array([0.7, -0.9, 0.8]))
    fast = ray_map.ray_map(toy_headset, viewpoint, plan)
    exact = ray_map.solve_every_pixel(toy_headset, viewpoint, plan.device_from_camera)
    pixel_size = np.abs(np.diff(exact.slope_offset[0], axis=1)).min()
    assert np.abs(fast.slope_offset - exact.slope_offset)[:2].max() < 0.01 * pixel_size
    assert np.abs(fast.slope_offset - exact.slope_offset)[2:].max() / ray_map.NEAREST_M < 0.01 * pixel_size
    assert (fast.status == Status.OK).all()
    # The measured error says so too, and says when there are too few nodes.
    pixel = np.random.default_rng(0).uniform(0.5, 79.5, (40, 2))
    assert ray_map.ray_map_error_px(toy_headset, viewpoint, plan, pixel).max() < 0.01
    coarse = ray_map.RayMapPlan.with_nodes(toy_headset.display.panel, 4, np.eye(3))
    assert ray_map.ray_map_error_px(toy_headset, viewpoint, coarse, pixel).max() > 0.02


def test_world_rays_are_the_mappings_rays_carried_by_the_head_pose(toy_headset: Eye) -> None:
    viewpoint = toy_headset.eye_box.at(np.array([0.3, 0.2, -0.5]))
    pose = transforms.rigid(transforms.rotation_about("y", 0.4), np.array([0.1, 1.5, 0.3]))
    plan = ray_map.choose_plan(toy_headset)
    field = ray_map.ray_map(toy_headset, viewpoint, plan)
    rows = slice(10, 14)
    origin, direction = field.world_rays(pose, rows)
    pixel = toy_headset.display.panel.pixel_centres()[rows].reshape(-1, 2)
    view = toy_headset.display.view_dir_of_pixel(pixel, viewpoint).value
    expected = rays.transformed(pose, toy_headset.see_through.real_ray_of_view_dir(view, viewpoint).value)
    np.testing.assert_allclose(np.linalg.norm(direction, axis=1), 1, atol=1e-6)
    assert directions.arcmin_between(direction.astype(float), expected[:, 3:]).max() < 0.01
    assert rays.distance_to_point(expected, origin.astype(float)).max() < 1e-6


def test_a_hole_is_solved_pixel_by_pixel_and_keeps_its_status(toy_headset_with_hole: Eye) -> None:
    plan = ray_map.RayMapPlan.with_nodes(toy_headset_with_hole.display.panel, 41, np.eye(3))
    field = ray_map.ray_map(toy_headset_with_hole, toy_headset_with_hole.eye_box.centre, plan)
    lost = field.status == Status.MISS
    assert 60 < lost.sum() < 100  # a disc of radius 5
    assert np.isnan(field.slope_offset[:, lost]).all()
    assert np.isfinite(field.slope_offset[:, ~lost]).all()


def test_subpixel_offset_moves_the_pixel_centres(toy_headset: Eye) -> None:
    panel = toy_headset.display.panel
    moved = ray_map.RayMapPlan.with_nodes(panel, 17, np.eye(3), np.array([0.25, -0.5]))
    viewpoint = toy_headset.eye_box.centre
    field = ray_map.ray_map(toy_headset, viewpoint, moved)
    exact = ray_map.solve_every_pixel(toy_headset, viewpoint, np.eye(3), panel.pixel_centres() + [0.25, -0.5])
    assert np.abs(field.slope_offset - exact.slope_offset).max() < 1e-6


def test_axes_look_at_the_middle_of_the_field_without_roll(toy_headset: Eye) -> None:
    headset = toy_headset
    axes = ray_map.middle_axes(headset)
    view = headset.display.view_dir_of_pixel(headset.display.panel.grid(9, 9), headset.eye_box.centre).value
    in_camera = view.reshape(-1, 3) @ axes
    middle = 0.5 * (in_camera.min(axis=0) + in_camera.max(axis=0))
    assert np.abs(middle[:2]).max() < 0.02
    assert axes[1, 0] == 0  # the camera's x axis stays level
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-15)


def test_required_tangents_cover_the_corner_pixels(toy_headset: Eye) -> None:
    viewpoint = toy_headset.eye_box.centre
    plan = ray_map.choose_plan(toy_headset)
    field = ray_map.ray_map(toy_headset, viewpoint, plan)
    asked = ray_map.required_tangents(toy_headset, plan.device_from_camera, viewpoint)
    # The interpolated field is float32.
    assert asked[:, 0].max() >= field.slope_offset[0].max() - 1e-6
    assert asked[:, 1].min() <= field.slope_offset[1].min() + 1e-6


@pytest.mark.parametrize("make", [WarpGrid.edge_to_edge, lambda panel, *size: WarpGrid.of_pixels(panel, size)])
def test_nodes_are_interpolated_to_the_points_of_any_grid(toy_headset: Eye, make: Callable[..., Any]) -> None:
    warp_grid, viewpoint = make(toy_headset.display.panel, 13, 7), toy_headset.eye_box.at(np.array([0.5, 0.1, -0.7]))
    field = ray_map.ray_map(toy_headset, viewpoint, ray_map.RayMapPlan.onto_grid(warp_grid, 17, np.eye(3)))
    exact = ray_map.solve_every_pixel(toy_headset, viewpoint, np.eye(3), warp_grid.panel_pixel())
    np.testing.assert_allclose(field.slope_offset, exact.slope_offset, atol=1e-6)
    np.testing.assert_array_equal(field.status, exact.status)


def test_around_an_unsolved_node_shifted_pixel_centres_are_solved_exactly(toy_headset_with_hole: Eye) -> None:
    offset, viewpoint = np.array([0.25, -0.5]), toy_headset_with_hole.eye_box.centre
    panel = toy_headset_with_hole.display.panel
    plan = ray_map.RayMapPlan.with_nodes(panel, 9, np.eye(3), offset)
    field = ray_map.ray_map(toy_headset_with_hole, viewpoint, plan)
    exact = ray_map.solve_every_pixel(toy_headset_with_hole, viewpoint, np.eye(3), panel.pixel_centres() + offset)
    np.testing.assert_array_equal(field.slope_offset, exact.slope_offset)


@pytest.mark.parametrize("pixels", [[1, 1], [2, 1], [1, 3]])
def test_panels_of_one_pixel_have_a_plan(tmp_path: Path, pixels: Sequence[int]) -> None:
    device = changed_device(tmp_path, "northstar", ("pixels = [1440, 1600]", f"pixels = {pixels}"))
    headset = traced_eye(load_device(device))
    plan = ray_map.choose_plan(headset)
    found = ray_map.ray_map(headset, headset.eye_box.centre, plan)
    exact = ray_map.solve_pixels(
        headset, plan.device_from_camera, headset.display.panel.pixel_centres().reshape(-1, 2), headset.eye_box.centre
    )
    np.testing.assert_allclose(found.slope_offset.reshape(4, -1).T, exact.slope_offset, atol=1e-4)
