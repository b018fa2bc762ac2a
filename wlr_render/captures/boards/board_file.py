"""Board files: board.toml with the design of a board and how far the print may differ from it."""

from pathlib import Path
from typing import Any

import numpy as np

from wlr_render.captures.boards.board import Board, BoardTolerances
from wlr_render.captures.boards.board_design import check_sizes
from wlr_render.captures.boards.dot_board import DotBoard
from wlr_render.errors import BadInputError
from wlr_render.numerics.arrays import BoolArray
from wlr_render.toml_files import Table, read_toml, write_toml

KINDS = ("dots",)
_COMMENT = """A board of large and small dots on a square grid. Lengths are millimetres as measured on the print:
where the printer scaled it, measure the ruler and multiply all four by measured / written.
sizes: one text per row of dots, from the top; 1 large, 0 small.
scale_sigma, flatness_mm, print_error_um: standard deviations of how far the print may differ from this design."""


def save_board(board: Board, path: str | Path) -> Path:
    """Write a board as TOML, so that `load_board` gives the same one back."""
    return write_toml(path, board_table(board), _COMMENT)


def board_table(board: Board) -> dict[str, Any]:
    """Return the keys and values of a board's file."""
    if not isinstance(board, DotBoard):
        raise TypeError(f"a {type(board).__name__} has no board file")
    return {
        "kind": "dots",
        "columns": board.columns,
        "rows": board.rows,
        "pitch_mm": _in_mm(board.pitch_m),
        "large_mm": _in_mm(board.large_m),
        "small_mm": _in_mm(board.small_m),
        "margin_mm": _in_mm(board.margin_m),
        "sizes": ["".join("1" if large else "0" for large in row) for row in board.large],
        **_tolerance_keys(board.tolerances),
    }


def load_board(path: str | Path) -> Board:
    """Read a board of any kind; a file without `kind` is a board of dots.

    Raises:
        BadInputError: the file is missing or not as `save_board` writes it, or its features cannot be distinguished;
            the sentence has the key.
    """
    table = read_toml(path)
    table.text("kind", "dots", choices=KINDS)
    tolerances = _tolerances(table)
    board = _dot_board(table, tolerances)
    table.finish()
    return board


def _dot_board(table: Table, tolerances: BoardTolerances) -> DotBoard:
    pitch_m, large_m, small_m, margin_m = (
        1e-3 * table.number(key) for key in ("pitch_mm", "large_mm", "small_mm", "margin_mm")
    )
    large = _sizes(table)
    for key, number in (("columns", large.shape[1]), ("rows", large.shape[0])):
        if table.number(key) != number:
            raise table.fail(f"'{key}' is {table.number(key):g}, but 'sizes' has {number} {key}; one is wrong.")
    try:
        check_sizes(pitch_m, large_m, small_m, margin_m)
    except BadInputError as error:
        raise table.fail(str(error)) from error
    return DotBoard(pitch_m, large_m, small_m, margin_m, large, tolerances)


def _tolerances(table: Table) -> BoardTolerances:
    usual = BoardTolerances()
    given = BoardTolerances(
        table.number("scale_sigma", usual.scale_sigma),
        1e-3 * table.number("flatness_mm", 1e3 * usual.flatness_m),
        1e-6 * table.number("print_error_um", 1e6 * usual.print_error_m),
    )
    for key, value in _tolerance_keys(given).items():
        if value < 0:
            raise table.fail(f"'{key}' is {value:g}; it must be a standard deviation, zero or more.")
    return given


def _tolerance_keys(tolerances: BoardTolerances) -> dict[str, float]:
    return {
        "scale_sigma": tolerances.scale_sigma,
        "flatness_mm": _in_mm(tolerances.flatness_m),
        "print_error_um": round(1e6 * tolerances.print_error_m, 6),
    }


def _sizes(table: Table) -> BoolArray:
    rows = table.texts("sizes")
    if len({len(row) for row in rows}) != 1 or set("".join(rows)) - {"0", "1"} or not rows[0]:
        raise table.fail("'sizes' must be texts of equal length, one per row of dots, of 1 for large and 0 for small.")
    return np.array([[digit == "1" for digit in row] for row in rows])


def _in_mm(length_m: float) -> float:
    """Millimetres as a person would write them; a thousandth of a micrometre is no news of a print."""
    return round(1e3 * length_m, 9)
