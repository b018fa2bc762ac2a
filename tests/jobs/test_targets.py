"""What a lab prints and shows."""

import numpy as np
import pytest

from wlr_render.captures.patterns.catalogue import make_pattern
from wlr_render.captures.photographs import photographs_in, read_photograph
from wlr_render.captures.targets.board_design import design_board
from wlr_render.captures.targets.board_file import load_board
from wlr_render.captures.targets.find_board import find_board
from wlr_render.errors import BadInputError
from wlr_render.jobs import targets
from wlr_render.mappings import Panel


def test_a_board_is_written_to_be_printed_and_to_be_read(tmp_path):
    svg, png, record = targets.write_board(tmp_path, 9, 7, 0.02, dots_per_inch=100, seed=3)
    board = load_board(record)
    assert np.array_equal(board.large, design_board(9, 7, 0.02, seed=3).large)
    assert board.pitch_m == pytest.approx(0.02)
    assert "mm" in svg.read_text(encoding="utf-8").split(">")[1]
    found = find_board(read_photograph(png), board)
    assert len(found) == 9 * 7
    step = found.pixel[1] - found.pixel[0]
    assert np.linalg.norm(step) == pytest.approx(20 / 25.4 * 100, abs=0.5)


def test_the_pictures_of_a_code_are_written_in_the_order_of_showing(tmp_path):
    count, page = targets.write_pattern(tmp_path, (64, 40), "gray")
    pattern = make_pattern("gray", Panel(64, 40))
    written = photographs_in(page.parent)
    assert count == len(written) == len(pattern.names())
    for number, path in enumerate(written):
        assert np.array_equal(read_photograph(path), pattern.image(number))
    assert page.is_file()


def test_what_cannot_be_made_is_refused_and_nothing_written(tmp_path):
    with pytest.raises(BadInputError, match="There is no code 'grey'"):
        targets.write_pattern(tmp_path / "a", (64, 40), "grey")
    with pytest.raises(BadInputError, match="take at least 5 x 5"):
        targets.write_board(tmp_path / "b", 2, 2, 0.02)
    assert list(tmp_path.iterdir()) == []
