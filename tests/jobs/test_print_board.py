"""Boards that a lab prints."""

from pathlib import Path

import numpy as np
import pytest
from present import narrowed

from wlr_render.captures.boards.board_design import design_board
from wlr_render.captures.boards.board_file import load_board
from wlr_render.captures.boards.dot_board import DotBoard
from wlr_render.captures.photographs import read_photograph
from wlr_render.errors import BadInputError
from wlr_render.jobs.print_board import BoardOptions, Kind, board


def test_a_board_is_written_to_be_printed_and_to_be_read(tmp_path: Path) -> None:
    svg, png, record = board(BoardOptions(columns=9, rows=7, dpi=100, seed=3, out=tmp_path)).files
    read = narrowed(load_board(record), DotBoard)
    assert np.array_equal(read.large, design_board(9, 7, 0.02, seed=3).large)
    assert read.pitch_m == pytest.approx(0.02)
    assert "mm" in svg.read_text(encoding="utf-8").split(">")[1]
    found = read.find(read_photograph(png))
    assert len(found) == 9 * 7
    step = found.pixel[1] - found.pixel[0]
    assert np.linalg.norm(step) == pytest.approx(20 / 25.4 * 100, abs=0.5)


@pytest.mark.parametrize(
    ("kind", "columns", "rows", "features"),
    [
        ("charuco", 9, 7, 8 * 6),
        ("april-grid", 4, 3, 8 * 6),
        ("chessboard", 9, 6, 8 * 5),
        ("circles", 9, 7, 63),
        ("asymmetric-circles", 4, 11, 44),
    ],
)
def test_boards_of_every_kind_are_written_and_found(
    tmp_path: Path, kind: Kind, columns: int, rows: int, features: int
) -> None:
    report = board(BoardOptions(kind=kind, columns=columns, rows=rows, pitch_mm=40, dpi=100, out=tmp_path))
    _, png, record = report.files
    read = load_board(record)
    assert read.title in report.verdict
    assert len(read.indices()) == features
    assert len(read.find(read_photograph(png))) >= 0.95 * features


def test_what_cannot_be_made_is_refused_and_nothing_written(tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match="take at least 5 x 5"):
        board(BoardOptions(columns=2, rows=2, out=tmp_path / "b"))
    assert list(tmp_path.iterdir()) == []
