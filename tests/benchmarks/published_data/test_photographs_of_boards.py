"""Boards on published photographs, as docs/measured-data.md shows them; skipped where the sets are not at hand."""

from dataclasses import replace

import pytest

from benchmarks.published_data.board_sets import SETS
from wlr_render.captures.boards.board import BoardNotFoundError
from wlr_render.captures.boards.chessboard import Chessboard
from wlr_render.captures.photographs import photographs_in, read_photograph


@pytest.mark.parametrize("which", SETS, ids=lambda which: which.title)
def test_two_photographs_of_each_set(measured_data, which):
    paths = which.photographs(measured_data("photos"))
    for path in (paths[0], paths[-1]):
        found = which.board.find(read_photograph(path), path.name)
        assert len(found) >= 0.4 * len(which.board.indices())
        assert found.ambiguous_half_turn == which.board.half_turn_symmetric


@pytest.mark.parametrize("name", ["ocamcalib-fisheye1-chessboard", "ocamcalib-fisheye2-chessboard"])
@pytest.mark.parametrize("size", [(4, 6), (5, 7)])
def test_a_chessboard_of_another_size_is_refused(measured_data, name, size):
    board = Chessboard(*size, 0.0325, 0.0)
    for path in photographs_in(measured_data("photos") / name)[::3]:
        with pytest.raises(BoardNotFoundError, match=path.name):
            board.find(read_photograph(path), path.name)


def test_the_legacy_pattern_is_named(measured_data):
    (which,) = (each for each in SETS if each.title == "feiran-charuco-stereo left")
    path = which.photographs(measured_data("photos"))[0]
    with pytest.raises(BoardNotFoundError, match="set legacy = true"):
        replace(which.board, legacy=False).find(read_photograph(path))
