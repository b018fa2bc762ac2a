"""ChArUco boards and AprilGrids: parts of them, the other pattern, other numbering, other boards."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from board_pictures import CAMERA, exposed, light_of, pose, truth

from wlr_render.captures.boards.april_grid import AprilGrid
from wlr_render.captures.boards.board import BoardNotFoundError
from wlr_render.captures.boards.charuco import CharucoBoard

CHARUCO = CharucoBoard(8, 6, 0.02, 0.015, "DICT_4X4_100")
APRIL = AprilGrid(4, 3, 0.032, 0.3)


def picture(board, **view):
    return exposed(cv2.GaussianBlur(light_of(CAMERA, pose(**view), board), (0, 0), 0.7), snr=40)


def test_our_picture_of_a_charuco_board_is_opencvs():
    for board in (CHARUCO, replace(CHARUCO, legacy=True)):
        made = cv2.aruco.CharucoBoard((8, 6), 0.02, 0.015, cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_100))
        made.setLegacyPattern(board.legacy)
        theirs = made.generateImage((8 * 80, 6 * 80))
        x, y = ((np.arange(n * 80) + 0.5) / 80 * 0.02 - 0.01 * n for n in (8, 6))
        ours = 255 * board.reflectance(np.stack(np.meshgrid(x, y), axis=-1))
        assert np.mean(ours != theirs) < 0.002


@pytest.mark.parametrize("turn_deg", [0, 100, 190, 280])
@pytest.mark.parametrize("board", [CHARUCO, replace(CHARUCO, legacy=True), APRIL], ids=["charuco", "legacy", "april"])
def test_part_of_a_board_is_identified(board, turn_deg):
    view = {"turn_deg": turn_deg, "tilt_deg": 25, "distance_m": 0.13}
    found = board.find(picture(board, **view))
    assert 8 <= len(found) < len(board.indices())
    assert np.abs(found.pixel - truth(CAMERA, pose(**view), found.index, board)).max() < 0.2


@pytest.mark.parametrize("legacy", [False, True])
def test_the_other_pattern_is_named(legacy):
    image = picture(replace(CHARUCO, legacy=legacy), distance_m=0.28)
    with pytest.raises(BoardNotFoundError, match=rf"^a\.png: .* set legacy = {str(legacy).lower()} in board\.toml"):
        replace(CHARUCO, legacy=not legacy).find(image, "a.png")


def test_another_charuco_board_is_named():
    image = picture(CHARUCO, distance_m=0.28)
    with pytest.raises(BoardNotFoundError, match=r"no marker of DICT_5X5_100 is in the picture"):
        replace(CHARUCO, dictionary="DICT_5X5_100").find(image)
    with pytest.raises(BoardNotFoundError, match=r"marker 23 of DICT_4X4_100 .* only has 0 to 14; is it another board"):
        replace(CHARUCO, square_columns=6, square_rows=5).find(image)


def test_numbering_from_another_corner_is_named():
    image = picture(APRIL, distance_m=0.28)
    with pytest.raises(BoardNotFoundError, match=r'^a\.png: .* set first_tag = "bottom-left" in board\.toml'):
        replace(APRIL, first_at_bottom=False).find(image, "a.png")


def test_another_april_grid_is_named():
    image = picture(APRIL, distance_m=0.28)
    with pytest.raises(BoardNotFoundError, match=r"0 tags of the board .* check border_bits"):
        AprilGrid(4, 3, 0.032, 0.3, border_bits=1).find(np.full_like(image, 90))
    with pytest.raises(BoardNotFoundError, match=r"tag 11 is in the picture, but .* has 20 to 31"):
        replace(APRIL, first_id=20).find(image)


@pytest.mark.parametrize("quarter_turns", [1, 2, 3])
def test_tags_may_be_printed_turned_in_their_places(monkeypatch, quarter_turns):
    """Printers of grids differ in which way up they print the tags of the dictionary."""
    image = picture(APRIL, turn_deg=10, distance_m=0.28)
    upright = APRIL.find(image)
    corners, numbers = APRIL._detect(image)
    monkeypatch.setattr(AprilGrid, "_detect", lambda self, grey: (np.roll(corners, quarter_turns, axis=1), numbers))
    turned = APRIL.find(image)
    assert np.array_equal(turned.index, upright.index)
    assert np.allclose(turned.pixel, upright.pixel, atol=0.01)
