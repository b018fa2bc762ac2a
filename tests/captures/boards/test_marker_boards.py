"""ChArUco boards and AprilGrids: parts of them, the other pattern, other numbering, other boards."""

from dataclasses import replace
from functools import cache
from itertools import product
from typing import Any

import cv2
import numpy as np
import pytest
from captures.boards.board_pictures import CAMERA, exposed, light_of, pose, truth
from numpy.typing import NDArray

from wlr_render.captures.boards.april_grid import AprilGrid
from wlr_render.captures.boards.board import BoardNotFoundError
from wlr_render.captures.boards.cell_pattern import CellBoard
from wlr_render.captures.boards.charuco import CharucoBoard

CHARUCO = CharucoBoard(8, 6, 0.02, 0.015, "DICT_4X4_100")
APRIL = AprilGrid(4, 3, 0.032, 0.3)


def picture(board: CellBoard, **view: Any) -> NDArray[np.uint8]:
    return exposed(cv2.GaussianBlur(light_of(CAMERA, pose(**view), board, rays=2), (0, 0), 0.7), snr=40)


@cache
def whole_picture(board: CellBoard) -> NDArray[np.uint8]:
    return picture(board, distance_m=0.28)


def test_our_picture_of_a_charuco_board_is_opencvs() -> None:
    for board in (CHARUCO, replace(CHARUCO, legacy=True)):
        made = cv2.aruco.CharucoBoard((8, 6), 0.02, 0.015, cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_100))
        made.setLegacyPattern(board.legacy)
        theirs = made.generateImage((8 * 80, 6 * 80))
        x, y = ((np.arange(n * 80) + 0.5) / 80 * 0.02 - 0.01 * n for n in (8, 6))
        ours = 255 * board.reflectance(np.stack(np.meshgrid(x, y), axis=-1))
        assert np.mean(ours != theirs) < 0.002


@pytest.mark.parametrize(
    ("board", "turn_deg"),
    [*product((CHARUCO, APRIL), (0, 100, 190, 280)), (replace(CHARUCO, legacy=True), 100)],
    ids=lambda value: value if isinstance(value, int) else type(value).__name__,
)
def test_part_of_a_board_is_identified(board: CellBoard, turn_deg: int) -> None:
    view: dict[str, Any] = {"turn_deg": turn_deg, "tilt_deg": 25, "distance_m": 0.13}
    found = board.find(picture(board, **view))
    assert 8 <= len(found) < len(board.indices())
    assert np.abs(found.pixel - truth(CAMERA, pose(**view), found.index, board)).max() < 0.2


def test_a_blurred_charuco_board_of_few_corners_is_refused() -> None:
    light = cv2.GaussianBlur(light_of(CAMERA, pose(distance_m=0.28), CHARUCO), (0, 0), 2.3)
    with pytest.raises(BoardNotFoundError, match=r"^a\.png: only [123] corners of the board were seen"):
        CHARUCO.find(exposed(light, snr=40), "a.png")


@pytest.mark.parametrize("legacy", [False, True])
def test_the_other_pattern_is_named(legacy: bool) -> None:
    image = whole_picture(replace(CHARUCO, legacy=legacy))
    with pytest.raises(BoardNotFoundError, match=rf"^a\.png: .* set legacy = {str(legacy).lower()} in board\.toml"):
        replace(CHARUCO, legacy=not legacy).find(image, "a.png")


@pytest.mark.parametrize("legacy", [False, True])
def test_the_other_pattern_of_an_odd_number_of_columns_is_named(legacy: bool) -> None:
    """Its markers lie as here but for one in every second row."""
    board = CharucoBoard(15, 8, 0.01, 0.0075, "DICT_5X5_100", legacy)
    image = cv2.copyMakeBorder(board._opencv.generateImage((900, 480)), 60, 60, 60, 60, cv2.BORDER_CONSTANT, value=255)
    image = (40 + 0.7 * cv2.GaussianBlur(image, (0, 0), 0.8)).astype(np.uint8)
    assert len(board.find(image)) == 14 * 7
    with pytest.raises(BoardNotFoundError, match=rf"set legacy = {str(legacy).lower()} in board\.toml"):
        replace(board, legacy=not legacy).find(image)


def test_another_charuco_board_is_named() -> None:
    image = whole_picture(CHARUCO)
    for changes, sentence in (
        ({"dictionary": "DICT_5X5_100"}, r"no marker of DICT_5X5_100 is in the picture, but 24 of DICT_4X4_1000"),
        (
            {"square_columns": 6, "square_rows": 5},
            r"marker 23 of DICT_4X4_100 .* only has 0 to 14; is it another board",
        ),
        ({"square_columns": 6, "square_rows": 8}, r"as on a board of 8 x 6 squares; exchange square_columns and"),
        ({"square_rows": 5}, r"marker 23 continues the board, which has 0 to 19 .* correct square_rows"),
        ({"square_columns": 9}, r"no corner lies between them as on a board of 9 x 6 squares"),
        ({"marker_m": 0.01}, r"markers are 0\.7\d of a square's side, where board\.toml has 0\.50; correct marker_mm"),
    ):
        with pytest.raises(BoardNotFoundError, match=sentence):
            replace(CHARUCO, **changes).find(image)
    with pytest.raises(BoardNotFoundError, match=r"check the dictionary in board\.toml, or expose more"):
        CHARUCO.find(np.full_like(image, 90))


def steep_view(tilt_deg: float = 76.0, focal_px: float = 1400.0, distance_m: float = 0.2) -> tuple[Any, Any, Any]:
    """A board of 17 x 11 squares tilted about x, and its homography from (x, y) in metres to pixels."""
    made = cv2.aruco.CharucoBoard((17, 11), 0.01, 0.0075, cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100))
    rotation = cv2.Rodrigues(np.array([np.deg2rad(tilt_deg), 0.0, 0.0]))[0]
    camera = np.array([[focal_px, 0, 640.0], [0, focal_px, 480.0], [0, 0, 1]])
    homography = camera @ np.column_stack([rotation[:, :2], [0.0, 0.0, distance_m]])
    metre = 0.01 / 60
    of_drawing = np.array([[metre, 0, 0.5 * metre - 0.085], [0, metre, 0.5 * metre - 0.055], [0, 0, 1]])
    fine = np.array([[3.0, 0, -0.5], [0, 3.0, -0.5], [0, 0, 1]])
    drawn = made.generateImage((17 * 60, 11 * 60))
    image = cv2.warpPerspective(drawn, fine @ homography @ of_drawing, (3840, 2880), borderValue=255)
    image = cv2.GaussianBlur(cv2.resize(image, (1280, 960), interpolation=cv2.INTER_AREA), (0, 0), 0.6)
    return made, (40 + 0.7 * image).astype(np.uint8), homography


def test_a_steep_charuco_board_is_found_where_opencv_takes_it_for_another() -> None:
    made, image, homography = steep_view()
    assert cv2.aruco.CharucoDetector(made).detectBoard(image)[1] is None
    board = CharucoBoard(17, 11, 0.01, 0.0075, "DICT_5X5_100")
    found = board.find(image)
    expected = cv2.perspectiveTransform(board.point_of(found.index)[:, None, :2], homography)[:, 0]
    assert len(found) > 50
    assert np.abs(found.pixel - expected).max() < 0.2
    with pytest.raises(BoardNotFoundError, match="exchange square_columns and square_rows"):
        replace(board, square_columns=11, square_rows=17).find(image)


@pytest.mark.parametrize("board", [CHARUCO, APRIL], ids=["charuco", "april"])
def test_a_board_seen_in_a_mirror_is_named(board: CellBoard) -> None:
    image = np.ascontiguousarray(whole_picture(board)[:, ::-1])
    with pytest.raises(BoardNotFoundError, match=r"^a\.png: the picture is mirrored"):
        board.find(image, "a.png")


def test_numbering_from_another_corner_is_named() -> None:
    image = whole_picture(APRIL)
    with pytest.raises(BoardNotFoundError, match=r'^a\.png: .* set first_tag = "bottom-left" in board\.toml'):
        replace(APRIL, first_at_bottom=False).find(image, "a.png")


def test_another_april_grid_is_named() -> None:
    image = whole_picture(APRIL)
    with pytest.raises(BoardNotFoundError, match=r"0 tags of the board .* check border_bits"):
        AprilGrid(4, 3, 0.032, 0.3, border_bits=1).find(np.full_like(image, 90))
    for changes, sentence in (
        ({"first_id": 20}, r"tag 11 is in the picture, but .* has 20 to 31"),
        ({"first_id": 1}, r"first tag has another number; correct first_id"),
        ({"tag_columns": 3, "tag_rows": 4}, r"as on a board of 4 columns, where .* has 3; exchange tag_columns and"),
        ({"tag_columns": 5}, r"as on a board of 4 columns, where .* has 5; correct tag_columns and tag_rows\."),
        ({"tag_columns": 5, "first_at_bottom": False}, r'and tag_rows, and set first_tag = "bottom-left"'),
        ({"tag_rows": 2}, r"tag 11 continues the board, which has 0 to 7 .* correct tag_rows or first_id"),
        ({"border_bits": 1}, r"\d+ tags .* borders are 2 bits wide, \d with border_bits = 1; set border_bits = 2"),
        (
            {"spacing": 0.25},
            r"gaps between tags are 0\.(299|300|301) .* has spacing = 0\.25: .* with print_error_um = 20",
        ),
        ({"spacing": 0.32}, r"gaps between tags are 0\.(299|300|301) .* has spacing = 0\.32"),
    ):
        with pytest.raises(BoardNotFoundError, match=sentence):
            replace(APRIL, **changes).find(image)
    assert len(replace(APRIL, spacing=0.305).find(image)) == len(APRIL.find(image))


def test_tags_printed_with_one_border_bit_and_two_stated_are_named() -> None:
    image = picture(replace(APRIL, border_bits=1), distance_m=0.28)
    with pytest.raises(
        BoardNotFoundError, match=r"\d+ tags .* 1 bits wide, 0 with border_bits = 2; set border_bits = 1"
    ):
        APRIL.find(image)


def test_tags_of_another_family_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as other:
        other.setattr("wlr_render.captures.boards.april_grid.DICTIONARY", "DICT_APRILTAG_25h9")
        image = picture(AprilGrid(4, 3, 0.032, 0.3), distance_m=0.28)
    with pytest.raises(BoardNotFoundError, match=r"\d+ tags of DICT_APRILTAG_25h9 are in the picture, and boards here"):
        AprilGrid(4, 3, 0.032, 0.3).find(image)


def test_corners_that_lie_on_no_plane_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where no other order of the tags is found, for example of tags numbered by columns."""
    monkeypatch.setattr(AprilGrid, "_refuse_other_layout", lambda *_: None)
    with pytest.raises(BoardNotFoundError, match=r"do not lie on a plane as the board's do; correct the numbers"):
        replace(APRIL, tag_columns=3, tag_rows=4).find(whole_picture(APRIL))


def test_tags_may_be_printed_turned_in_their_places(monkeypatch: pytest.MonkeyPatch) -> None:
    """Printers of grids differ in which way up they print the tags of the dictionary."""
    image = whole_picture(APRIL)
    upright = APRIL.find(image)
    corners, numbers = APRIL._detect(image)
    for quarter_turns in (1, 2, 3):
        of_turned = np.roll(corners, quarter_turns, axis=1)
        monkeypatch.setattr(AprilGrid, "_detect", lambda self, grey, at=of_turned: (at, numbers))
        turned = APRIL.find(image)
        assert np.array_equal(turned.index, upright.index)
        assert np.allclose(turned.pixel, upright.pixel, atol=0.01)
