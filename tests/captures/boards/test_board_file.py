"""What is printed has the size that it should have, and a saved board comes back."""

import re
import xml.etree.ElementTree as ET

import numpy as np
import pytest
from board_pictures import BOARD
from PIL import Image

from wlr_render.captures.boards.board_design import design_board
from wlr_render.captures.boards.board_drawing import write_board_png, write_board_svg
from wlr_render.captures.boards.board_file import load_board, save_board
from wlr_render.captures.photographs import read_photograph
from wlr_render.errors import BadInputError

SVG = "{http://www.w3.org/2000/svg}"


def test_a_saved_board_comes_back(tmp_path):
    back = load_board(save_board(BOARD, tmp_path / "board.toml"))
    assert np.array_equal(back.large, BOARD.large)
    lengths = [[each.pitch_m, each.large_m, each.small_m, each.margin_m] for each in (back, BOARD)]
    assert np.allclose(*lengths, rtol=1e-12)


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("pitch_mm", "pitch_m", r"'pitch_mm' is missing \(found 'pitch_m' instead\)"),
        ("large_mm = 6.0", "large_mm = 60.0", "nearly touch"),
        ("columns = 18", "columns = 17", "'columns' is 17, but 'sizes' has 18 columns"),
        ('"001100010100000110"', '"0011000101000001x0"', "'sizes' must be texts of equal length"),
        ('"001100010100000110"', "1100", "'sizes' must be a list of texts"),
    ],
)
def test_a_board_file_that_is_wrong_is_named(tmp_path, old, new, sentence):
    path = save_board(BOARD, tmp_path / "board.toml")
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    with pytest.raises(BadInputError, match=sentence) as caught:
        load_board(path)
    assert str(path) in str(caught.value)


def test_circles_of_the_svg_lie_where_the_board_has_its_dots(tmp_path):
    root = ET.parse(write_board_svg(BOARD, tmp_path / "board.svg")).getroot()
    width, height = float(root.get("width").removesuffix("mm")), float(root.get("height").removesuffix("mm"))
    assert root.get("viewBox").split()[2:] == [f"{width:.4f}", f"{height:.4f}"], "a user unit is not a millimetre"
    circles = root.findall(f"{SVG}circle")
    drawn = np.array([[float(circle.get(key)) for key in ("cx", "cy", "r")] for circle in circles])
    corner_m = 0.5 * BOARD.size_m
    assert np.allclose(1e-3 * drawn[:, :2] - corner_m, BOARD.point_of(BOARD.indices())[:, :2], atol=1e-7)
    assert np.allclose(2e-3 * drawn[:, 2], BOARD.diameter_of(BOARD.indices()), atol=2e-7)
    assert [circle.get("class") == "large" for circle in circles] == BOARD.large.ravel().tolist()


@pytest.mark.parametrize(("board", "dpi"), [(BOARD, 300), (design_board(5, 5, 0.002), 1200)], ids=["usual", "tiny"])
def test_the_ruler_is_as_long_as_is_written_beside_it(tmp_path, board, dpi):
    root = ET.parse(write_board_svg(board, tmp_path / "board.svg")).getroot()
    line = re.match(r"M (\S+) (\S+) h (\S+)", root.find(f"{SVG}path").get("d"))
    left, y, length = (float(number) for number in line.groups())
    assert root.findall(f"{SVG}text")[0].text == f"{length:g} mm"
    assert left + length < float(root.get("width").removesuffix("mm"))

    pixels_per_mm = dpi / 25.4
    picture = np.array(Image.open(write_board_png(board, tmp_path / "board.png", dpi)))
    dark = np.nonzero(picture[round(y * pixels_per_mm), : round((left + length + 1) * pixels_per_mm)] < 128)[0]
    # From the middle of one end's line, 0.2 mm wide, to that of the other's.
    assert (dark[-1] - dark[0] + 1) / pixels_per_mm - 0.2 == pytest.approx(length, abs=1.5 / pixels_per_mm)


def test_dots_of_the_png_have_the_pitch_of_its_resolution(tmp_path):
    path = write_board_png(BOARD, tmp_path / "board.png", 150)
    with Image.open(path) as picture:
        assert picture.info["dpi"] == pytest.approx((150, 150), rel=1e-4)  # whole pixels per metre
    found = BOARD.find(read_photograph(path))
    assert len(found) == BOARD.large.size
    in_board = BOARD.point_of(found.index)[:, :2] + 0.5 * BOARD.size_m
    assert np.allclose(found.pixel, in_board * 150 / 0.0254, atol=0.03)


def test_a_png_too_coarse_for_its_dots_is_refused(tmp_path):
    with pytest.raises(BadInputError, match=r"smallest shapes are 6\.0 pixels wide; choose another resolution"):
        write_board_png(BOARD, tmp_path / "board.png", 40)
    assert not list(tmp_path.iterdir())
