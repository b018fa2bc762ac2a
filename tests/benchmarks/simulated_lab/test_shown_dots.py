"""The target as it is drawn: of the shape found; dots that the panel's edge would cut are not judged."""

import numpy as np
from present import present

from benchmarks.simulated_lab.drawn_target import target_scene, wholly_shown
from wlr_render.calibration.bench.board_shape import BoardShape
from wlr_render.captures.boards.board_design import design_board
from wlr_render.geometry import transforms
from wlr_render.optics.device_file import load_device
from wlr_render.optics.traced_mappings import traced_eye


def test_a_dot_is_whole_where_its_rim_is_on_the_panel() -> None:
    models = traced_eye(load_device("no_optics"), "right")
    viewpoint = models.eye_box.centre
    edges = models.display.panel.size_px * [[0.5, 0.5], [0.0, 0.5], [1.0, 0.5]]
    middle, left, right = models.display.view_dir_of_pixel(edges, viewpoint).value
    distance = 0.5
    # The board hangs before the panel's middle; by far too wide, so that the panel's edges cut some column of dots.
    board = design_board(24, 7, 0.0485 * distance)
    pose = transforms.rigid(transforms.OPENXR_FROM_OPENCV, viewpoint + distance * middle / -middle[2])
    shown = wholly_shown(models, board, pose, viewpoint)
    point = transforms.apply(pose, board.point_of(board.indices()))
    tangent = ((point - viewpoint)[:, 0] / -(point - viewpoint)[:, 2]).reshape(board.rows, board.columns)
    reach = 0.5 * board.diameter_of(board.indices()).reshape(board.rows, board.columns) / distance
    low, high = sorted((left[0] / -left[2], right[0] / -right[2]))
    centre_row = board.rows // 2
    whole = (tangent - reach > low) & (tangent + reach < high)
    assert shown[centre_row].any()
    assert not np.any(shown & ~whole)
    clearly = (tangent - 1.6 * reach > low) & (tangent + 1.6 * reach < high)
    assert shown[centre_row][clearly[centre_row]].all()
    centre_seen = (tangent > low) & (tangent < high)
    assert np.any(whole[centre_row] != centre_seen[centre_row])  # some dots are cut


def test_the_target_is_drawn_in_the_shape_that_calibration_found() -> None:
    board = design_board(9, 7, 0.02)
    index = board.indices()
    nominal = board.point_of(index)
    own = np.random.default_rng(2).normal(0.0, 1e-5, nominal.shape)
    low = np.array([2e-4, -1e-4, 5e-5, 3e-4, -4e-4, 2e-4])
    order = np.lexsort((index[:, 1], index[:, 0]))
    shape = BoardShape(np.abs(nominal[:, :2]).max(axis=0), low, index[order], own[order])
    pose = transforms.rigid(transforms.OPENXR_FROM_OPENCV, np.array([0.0, 0.0, -0.5]))
    scene = target_scene(board, shape, pose)
    (mesh,), (instance,) = scene.meshes, scene.instances
    vertex = transforms.apply(instance.world_from_mesh, mesh.position.astype(float))
    # A vertex lies at each dot's centre: the texture's place says which.
    at = (present(mesh.uv) - 0.5) * board.size_m
    nearest = np.argmin(np.linalg.norm(at[:, None] - nominal[:, :2], axis=-1), axis=0)
    np.testing.assert_allclose(at[nearest], nominal[:, :2], atol=1e-7)
    expected = transforms.apply(pose, shape.point_of(index, nominal))
    np.testing.assert_allclose(vertex[nearest], expected, atol=1e-7)
    assert np.linalg.norm(vertex[nearest] - transforms.apply(pose, nominal), axis=-1).max() > 1e-4
