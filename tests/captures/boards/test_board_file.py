"""What is printed has the size that it should have, and a saved board comes back."""

import re
import xml.etree.ElementTree as ET
from dataclasses import astuple, replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from captures.boards.board_pictures import BOARD
from PIL import Image
from present import narrowed, present

from wlr_render.captures.boards.april_grid import AprilGrid
from wlr_render.captures.boards.board import BoardTolerances
from wlr_render.captures.boards.board_design import design_board
from wlr_render.captures.boards.board_drawing import write_board_png, write_board_svg
from wlr_render.captures.boards.board_file import board_table, load_board, save_board
from wlr_render.captures.boards.charuco import CharucoBoard
from wlr_render.captures.boards.chessboard import Chessboard
from wlr_render.captures.boards.circle_grid import CircleGrid
from wlr_render.captures.boards.dot_board import DotBoard
from wlr_render.captures.photographs import read_photograph
from wlr_render.errors import BadInputError

SVG = "{http://www.w3.org/2000/svg}"


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("pitch_mm", "pitch_m", r"'pitch_mm' is missing \(found 'pitch_m' instead\)"),
        ("large_mm = 6.0", "large_mm = 60.0", "nearly touch"),
        ("columns = 18", "columns = 17", "'columns' is 17, but 'sizes' has 18 columns"),
        ('"001100010100000110"', '"0011000101000001x0"', "it must be texts of equal length"),
        ('"001100010100000110"', "1100", "'sizes' must be a list of texts"),
    ],
)
def test_a_board_file_that_is_wrong_is_named(tmp_path: Path, old: str, new: str, sentence: str) -> None:
    path = save_board(BOARD, tmp_path / "board.toml")
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    with pytest.raises(BadInputError, match=sentence) as caught:
        load_board(path)
    assert str(path) in str(caught.value)


def test_circles_of_the_svg_lie_where_the_board_has_its_dots(tmp_path: Path) -> None:
    root = ET.parse(write_board_svg(BOARD, tmp_path / "board.svg")).getroot()
    width, height = (
        float(present(root.get("width")).removesuffix("mm")),
        float(present(root.get("height")).removesuffix("mm")),
    )
    assert present(root.get("viewBox")).split()[2:] == [f"{width:.4f}", f"{height:.4f}"], (
        "a user unit is not a millimetre"
    )
    circles = root.findall(f"{SVG}circle")
    drawn = np.array([[float(present(circle.get(key))) for key in ("cx", "cy", "r")] for circle in circles])
    corner_m = 0.5 * BOARD.size_m
    assert np.allclose(1e-3 * drawn[:, :2] - corner_m, BOARD.point_of(BOARD.indices())[:, :2], atol=1e-7)
    assert np.allclose(2e-3 * drawn[:, 2], BOARD.diameter_of(BOARD.indices()), atol=2e-7)
    assert [circle.get("class") == "large" for circle in circles] == BOARD.large.ravel().tolist()


@pytest.mark.parametrize(("board", "dpi"), [(BOARD, 300), (design_board(5, 5, 0.002), 1200)], ids=["usual", "tiny"])
def test_the_ruler_is_as_long_as_is_written_beside_it(tmp_path: Path, board: DotBoard, dpi: int) -> None:
    root = ET.parse(write_board_svg(board, tmp_path / "board.svg")).getroot()
    line = re.match(r"M (\S+) (\S+) h (\S+)", present(present(root.find(f"{SVG}path")).get("d")))
    left, y, length = (float(number) for number in present(line).groups())
    assert root.findall(f"{SVG}text")[0].text == f"{length:g} mm"
    assert left + length < float(present(root.get("width")).removesuffix("mm"))

    pixels_per_mm = dpi / 25.4
    picture = np.array(Image.open(write_board_png(board, tmp_path / "board.png", dpi)))
    dark = np.nonzero(picture[round(y * pixels_per_mm), : round((left + length + 1) * pixels_per_mm)] < 128)[0]
    # From the middle of one end's line, 0.2 mm wide, to that of the other's.
    assert (dark[-1] - dark[0] + 1) / pixels_per_mm - 0.2 == pytest.approx(length, abs=1.5 / pixels_per_mm)


def test_dots_of_the_png_have_the_pitch_of_its_resolution(tmp_path: Path) -> None:
    path = write_board_png(BOARD, tmp_path / "board.png", 150)
    with Image.open(path) as picture:
        assert picture.info["dpi"] == pytest.approx((150, 150), rel=1e-4)  # whole pixels per metre
    found = BOARD.find(read_photograph(path))
    assert len(found) == BOARD.large.size
    in_board = BOARD.point_of(found.index)[:, :2] + 0.5 * BOARD.size_m
    assert np.allclose(found.pixel, in_board * 150 / 0.0254, atol=0.03)


def test_a_png_too_coarse_for_its_dots_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match=r"smallest shapes are 6\.0 pixels wide; choose another resolution"):
        write_board_png(BOARD, tmp_path / "board.png", 40)
    assert not list(tmp_path.iterdir())


KINDS = {
    "dots": replace(BOARD, tolerances=BoardTolerances(1e-3, 1e-3, 5e-6)),
    "charuco": CharucoBoard(8, 6, 0.0254, 0.01905, "DICT_4X4_1000", legacy=True, margin_m=0.01),
    "april-grid": AprilGrid(6, 5, 0.04, 0.25, border_bits=1, first_id=4, first_at_bottom=False),
    "chessboard": Chessboard(9, 6, 0.02423, 0.02, BoardTolerances(flatness_m=0.0)),
    "circles": CircleGrid(9, 7, 0.02, 0.012, 0.02),
    "asymmetric-circles": CircleGrid(4, 11, 0.02, 0.02, 0.03, staggered=True),
}


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_comes_back_as_it_was_written(tmp_path: Path, kind: str) -> None:
    path = save_board(KINDS[kind], tmp_path / "board.toml")
    assert f'kind = "{kind}"' in path.read_text()
    back = load_board(path)
    assert type(back) is type(KINDS[kind])
    assert board_table(back) == board_table(KINDS[kind])
    assert np.allclose(back.point_of(back.indices()), KINDS[kind].point_of(KINDS[kind].indices()), atol=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_is_found_in_its_own_drawing(tmp_path: Path, kind: str) -> None:
    board = KINDS[kind]
    image = read_photograph(write_board_png(board, tmp_path / "board.png", 150))
    found = board.find(cv2.GaussianBlur(np.asarray(image), (0, 0), 1.0))
    assert len(found) >= 0.95 * len(board.indices()), "but for what the ruler touches"
    per_metre = 150 / 0.0254
    numbered = found, found.half_turned(board)
    there = [per_metre * (board.point_of(each.index)[:, :2] + 0.5 * board.size_m) for each in numbered]
    assert min(np.abs(found.pixel - place).max() for place in there) < 0.6, "as the picture's size is rounded"
    drawn = ET.parse(write_board_svg(board, tmp_path / "board.svg")).getroot()
    assert board.title in present(present(drawn.find(f"{SVG}title")).text)


def test_a_file_without_a_kind_is_a_board_of_dots(tmp_path: Path) -> None:
    path = save_board(BOARD, tmp_path / "board.toml")
    kept = [
        line for line in path.read_text().splitlines() if not re.match("kind|scale_sigma|flatness|print_error", line)
    ]
    path.write_text("\n".join(kept))
    board = narrowed(load_board(path), DotBoard)
    assert np.array_equal(board.large, BOARD.large)
    assert np.allclose(astuple(board.tolerances), astuple(BoardTolerances()))


def test_a_board_on_a_monitor_is_given_in_its_pixels(tmp_path: Path) -> None:
    path = tmp_path / "board.toml"
    path.write_text(
        'kind = "chessboard"\nscreen = true\npixel_pitch_mm = 0.25\ncorner_columns = 9\ncorner_rows = 6\n'
        "square_px = 100\nmargin_px = 20\n"
    )
    board = narrowed(load_board(path), Chessboard)
    assert board.square_m == pytest.approx(0.025)
    assert board.margin_m == pytest.approx(0.005)


@pytest.mark.parametrize(
    ("kind", "old", "new", "sentence"),
    [
        ("charuco", 'kind = "charuco"', 'kind = "charucco"', "'kind' is 'charucco'; it must be one of dots, charuco"),
        ("charuco", "marker_mm = 19.05", "marker_mm = 30", "'marker_mm' is not smaller than 'square_mm'"),
        ("charuco", "square_columns = 8", "square_columns = 800", "needs 2400 markers, but DICT_4X4_1000 has 1000"),
        (
            "april-grid",
            "spacing = 0.25",
            "spacing = 2.5",
            "'spacing' is 2.5; it must be the gap between tags over their side",
        ),
        ("april-grid", "first_id = 4", "first_id = 570", "needs tags up to 599, but 36h11 ends at 586"),
        ("chessboard", "corner_columns = 9", "corner_columns = 6", "looks the same turned by 90 degrees"),
        ("chessboard", "square_mm", "square_px", r"'square_mm' is missing \(found 'square_px' instead\)"),
        ("circles", "columns = 9", "columns = 7", "looks the same turned by 90 degrees"),
        ("circles", "diameter_mm = 12", "diameter_mm = 20", "circles nearly touch"),
    ],
)
def test_a_file_of_another_kind_that_is_wrong_is_named(
    tmp_path: Path, kind: str, old: str, new: str, sentence: str
) -> None:
    path = save_board(KINDS[kind], tmp_path / "board.toml")
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(BadInputError, match=sentence) as caught:
        load_board(path)
    assert str(path) in str(caught.value)


APRIL_OF_KALIBR = "target_type: 'aprilgrid' #gridtype\ntagCols: 6\ntagRows: 5\ntagSize: 0.088\ntagSpacing: 0.3\n"
CHECKER_OF_KALIBR = (
    "target_type: 'checkerboard'\ntargetCols: 6\ntargetRows: 7\nrowSpacingMeters: 0.06\ncolSpacingMeters: 0.06\n"
)


def test_targets_of_kalibr_are_read(tmp_path: Path) -> None:
    file = tmp_path / "target.yaml"
    file.write_text(APRIL_OF_KALIBR)
    expected = AprilGrid(6, 5, 0.088, 0.3, border_bits=2, first_id=0, first_at_bottom=True)
    assert board_table(load_board(file)) == board_table(expected)
    file.write_text(APRIL_OF_KALIBR.replace("0.088", "88e-3") + "codeOffset: 7\n")
    assert board_table(load_board(file)) == board_table(replace(expected, first_id=7))
    file.write_text(CHECKER_OF_KALIBR)
    assert board_table(load_board(file)) == board_table(Chessboard(6, 7, 0.06, 0.06))


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (APRIL_OF_KALIBR.replace("tagRows: 5\n", ""), "key 'tagRows' is missing"),
        (APRIL_OF_KALIBR + "tagFamily: t16h5\n", "unknown key 'tagFamily'"),
        (CHECKER_OF_KALIBR.replace("colSpacingMeters: 0.06", "colSpacingMeters: 0.05"), "square squares"),
        ("target_type: circlegrid\ntargetCols: 6\n", "has no diameter of the circles"),
        ("target_type: hexgrid\n", "must be one of aprilgrid, checkerboard, circlegrid"),
        ("", "is not a target of Kalibr; write board.toml"),
    ],
)
def test_what_is_not_read_of_a_target_of_kalibr_is_named(tmp_path: Path, text: str, sentence: str) -> None:
    (tmp_path / "target.yaml").write_text(text)
    with pytest.raises(BadInputError, match=rf"target\.yaml: .*{sentence}"):
        load_board(tmp_path / "target.yaml")
