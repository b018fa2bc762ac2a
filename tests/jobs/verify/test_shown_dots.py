"""Dots that the panel's edge would cut are not judged."""

import numpy as np

from wlr_render.captures.boards.board_design import design_board
from wlr_render.geometry import transforms
from wlr_render.jobs.verify.session import wholly_shown
from wlr_render.optics.device_file import load_device
from wlr_render.optics.traced_mappings import traced_eye


def test_a_dot_is_whole_where_its_rim_is_on_the_panel():
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
