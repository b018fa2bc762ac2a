"""A board that is not flat is drawn where it says that its dots are."""

import numpy as np
import pytest

from wlr_render.captures.boards.board_design import design_board
from wlr_render.geometry.transforms import OPENXR_FROM_OPENCV, apply, inverse, rigid, rotation_about
from wlr_render.lenses.lens_camera import LensCamera
from wlr_render.numerics.arrays import FloatArray
from wlr_render.simulation.photographs.board_light import BoardLight, FarWall
from wlr_render.simulation.photographs.camera import SimulatedLens
from wlr_render.simulation.photographs.camera_view import CameraView
from wlr_render.simulation.photographs.imperfections import BenchImperfections
from wlr_render.simulation.photographs.printed_board import PrintedBoard

CAMERA = LensCamera((640, 480), np.array([800.0, 800.0]), np.array([321.0, 238.0]), np.array([-0.1, 0.02, 1e-3, 0, 0]))
LOOKING_AHEAD = rigid(OPENXR_FROM_OPENCV, np.zeros(3))
TILTED = rigid(OPENXR_FROM_OPENCV @ rotation_about("y", 0.5) @ rotation_about("x", -0.3), np.array([0.01, -0.02, -0.6]))


@pytest.mark.parametrize("seed", [1, 4])
@pytest.mark.slow
def test_the_dots_of_a_bent_board_are_found_where_they_are_stated(seed: int) -> None:
    board = design_board(17, 13, 0.022)
    sizes = BenchImperfections(bow_mm=4.0, twist_mm=2.0, anisotropy=5e-3, scale_error=5e-3, dot_error_um=30.0)
    printed = PrintedBoard.draw(board, sizes, np.random.default_rng(seed))
    view = CameraView.without_headset(SimulatedLens(CAMERA, 0.001, 0.6), LOOKING_AHEAD, samples=32)
    light = view.world_light(BoardLight(printed, TILTED, FarWall(brightness=0.0)))
    found = board.find(np.rint(60000.0 * light).astype(np.uint16))
    assert len(found) > 150
    camera_from_board = inverse(LOOKING_AHEAD) @ TILTED

    def off(point: FloatArray) -> FloatArray:
        return found.pixel - CAMERA.pixel_of_point(apply(camera_from_board, point))

    assert np.sqrt(np.mean(off(printed.point_of(found.index)) ** 2)) < 0.02
    assert np.sqrt(np.mean(off(board.point_of(found.index)) ** 2)) > 0.5
