"""Chessboards that look the same turned, boards of another size than stated, and wide lenses."""

from functools import cache
from itertools import product
from typing import Any

import cv2
import numpy as np
import pytest
from captures.boards.board_pictures import BARREL, CAMERA, exposed, light_of, pose, truth
from numpy.typing import NDArray

from wlr_render.captures.boards.board import BoardNotFoundError
from wlr_render.captures.boards.chessboard import Chessboard
from wlr_render.lenses.lens_camera import LensCamera

BOARD = Chessboard(8, 5, 0.018, 0.018)
TURNS = [0, 75, 180, 290]


def picture(board: Chessboard, turn_deg: float = 20.0, camera: LensCamera = CAMERA, **view: Any) -> NDArray[np.uint8]:
    return exposed(cv2.GaussianBlur(light_of(camera, pose(turn_deg, **view), board, rays=2), (0, 0), 0.7), snr=40)


@pytest.mark.slow
@pytest.mark.parametrize("turn_deg", TURNS)
def test_a_board_with_an_odd_sum_is_numbered_from_its_own_corner(turn_deg: int) -> None:
    found = BOARD.find(picture(BOARD, turn_deg, distance_m=0.3))
    assert not found.ambiguous_half_turn
    assert np.abs(found.pixel - truth(CAMERA, pose(turn_deg, distance_m=0.3), found.index, BOARD)).max() < 0.2


@pytest.mark.slow
@pytest.mark.parametrize("turn_deg", TURNS)
def test_a_board_with_an_even_sum_says_that_it_may_be_turned(turn_deg: int) -> None:
    board = Chessboard(6, 4, 0.02, 0.02)
    found = board.find(picture(board, turn_deg, distance_m=0.3))
    assert found.ambiguous_half_turn
    there = pose(turn_deg, distance_m=0.3)
    off = [
        np.abs(each.pixel - truth(CAMERA, there, each.index, board)).max() for each in (found, found.half_turned(board))
    ]
    assert min(off) < 0.2
    assert max(off) > 50


@cache
def tilted_picture(camera: LensCamera) -> NDArray[np.uint8]:
    """A picture in which the whole board is found."""
    image = picture(BOARD, camera=camera, distance_m=0.3, tilt_deg=20)
    assert len(BOARD.find(image)) == 40
    return image


@pytest.mark.parametrize(
    ("camera", "size"),
    [*product([CAMERA], [(7, 5), (8, 4), (7, 4), (6, 4), (4, 3), (6, 3)]), *product([BARREL], [(8, 4), (6, 3)])],
)
def test_part_of_a_larger_chessboard_is_not_taken_for_a_whole_one(camera: LensCamera, size: tuple[int, int]) -> None:
    with pytest.raises(BoardNotFoundError, match=r"^left\.png: "):
        Chessboard(*size, 0.018, 0.018).find(tilted_picture(camera), "left.png")


def test_a_larger_chessboard_that_is_found_in_part_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """The detector is made to return part of the board, as OpenCV's did on real photographs."""
    image = picture(BOARD, distance_m=0.3)
    whole = np.asarray(truth(CAMERA, pose(20.0, distance_m=0.3), BOARD.indices(), BOARD)).reshape(5, 8, 2)
    wrong = Chessboard(6, 5, 0.018, 0.018)
    monkeypatch.setattr(Chessboard, "_detect", lambda self, grey: iter([whole[:, :6]]))
    with pytest.raises(BoardNotFoundError, match=r"more squares than board\.toml says .* go on at its right"):
        wrong.find(image)
    monkeypatch.setattr(Chessboard, "_detect", lambda self, grey: iter([whole[:, 1:7]]))
    with pytest.raises(BoardNotFoundError, match="go on at its left and right"):
        wrong.find(image)
    monkeypatch.setattr(Chessboard, "_detect", lambda self, grey: iter([whole[:, ::2]]))
    with pytest.raises(BoardNotFoundError, match="leaving out others"):
        Chessboard(4, 5, 0.018, 0.018).find(image)


def test_a_chessboard_of_fewer_squares_than_stated_is_named() -> None:
    """OpenCV takes the edge of the board for a line of corners."""
    image = picture(BOARD, turn_deg=10.0, distance_m=0.3, tilt_deg=20)
    with pytest.raises(BoardNotFoundError, match=r"a whole outer line does not look like corners.* fewer squares"):
        Chessboard(8, 6, 0.018, 0.018).find(image)


def test_a_frame_or_a_cluttered_surround_is_no_further_row_of_squares() -> None:
    board = Chessboard(8, 5, 0.018, 0.006)
    light = light_of(CAMERA, pose(20.0, distance_m=0.3), board, surround=0.0)
    rng = np.random.default_rng(2)
    clutter = cv2.resize(rng.random((25, 30)), (480, 400), interpolation=cv2.INTER_NEAREST)
    image = exposed(cv2.GaussianBlur(np.where(light == 0.0, clutter, light), (0, 0), 0.7), snr=40)
    assert len(board.find(image)) == 40


def test_no_chessboard_is_named() -> None:
    with pytest.raises(BoardNotFoundError, match=r"^a\.png: no chessboard of 8 x 5 inner corners is in the picture"):
        BOARD.find(np.full((300, 400), 90, np.uint8), "a.png")
