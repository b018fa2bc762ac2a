"""Board files: board.toml with the design of a board of any kind and the tolerances of its print.

Kalibr's target files are read, too.
"""

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from wlr_render.captures.boards.april_grid import DICTIONARY, AprilGrid
from wlr_render.captures.boards.board import Board, BoardTolerances
from wlr_render.captures.boards.board_design import check_sizes
from wlr_render.captures.boards.charuco import CharucoBoard
from wlr_render.captures.boards.chessboard import Chessboard
from wlr_render.captures.boards.circle_grid import CircleGrid
from wlr_render.captures.boards.dot_board import DotBoard
from wlr_render.captures.boards.markers import DICTIONARIES, dictionary_of
from wlr_render.captures.plain_data import read_mapping
from wlr_render.io.delimited_text import is_number
from wlr_render.io.input_files import LIMITS, prefix_errors, read_text
from wlr_render.io.toml_files import Table, read_toml, write_toml
from wlr_render.numerics.arrays import BoolArray

KINDS = ("dots", "charuco", "april-grid", "chessboard", "circles", "asymmetric-circles")
"""Values of `kind`."""

_LENGTH_M = (5e-5, 2.0)  # plausible size of a square, dot or gap: beyond, lengths are in another unit
_LARGEST_PITCH_MM = 50.0
_MOST = 2000  # most rows or columns

_COMMENT = """A calibration board. Lengths are millimetres as measured on the print:
where the printer scaled it, measure the ruler and multiply all of them by measured / written.
scale_sigma, flatness_mm, print_error_um: standard deviations of how far the print may differ from this design."""
_DOTS_COMMENT = "\nsizes: one text per row of dots, from the top; 1 large, 0 small."
_FIRST_TAGS = ("top-left", "bottom-left")
_KALIBR_SUFFIXES = (".yaml", ".yml")
_KALIBR_TARGETS = ("aprilgrid", "checkerboard", "circlegrid")
_CLASSES = (DotBoard, CharucoBoard, AprilGrid, Chessboard, CircleGrid)  # classes in the order of KINDS


def save_board(board: Board, path: str | Path) -> Path:
    """Write a board as TOML that `load_board` reads back."""
    return write_toml(path, board_table(board), _COMMENT + (_DOTS_COMMENT if isinstance(board, DotBoard) else ""))


def board_table(board: Board) -> dict[str, Any]:
    """Return the keys and values of a board's file.

    Raises:
        TypeError: the board is of a class without a file form.
    """
    return {**_design_keys(board), **_tolerance_keys(board.tolerances)}


def _design_keys(board: Board) -> dict[str, Any]:
    """Return a key for each attribute of a board, in their order; lengths in millimetres."""
    if not isinstance(board, _CLASSES):
        raise TypeError(f"a {type(board).__name__} has no board file")
    kind = KINDS[_CLASSES.index(type(board))]
    keys: dict[str, Any] = {"kind": kind}
    if isinstance(board, DotBoard):
        keys |= {"columns": board.columns, "rows": board.rows}
    for name in (each.name for each in fields(board) if each.name != "tolerances"):
        value = getattr(board, name)
        if name.endswith("_m"):
            keys[f"{name}m"] = _in_mm(value)
        elif name == "large":
            keys["sizes"] = ["".join("1" if large else "0" for large in row) for row in value]
        elif name == "first_at_bottom":
            keys["first_tag"] = _FIRST_TAGS[value]
        elif name == "staggered":
            keys["kind"] = "asymmetric-circles" if value else kind
        else:
            keys[f"corner_{name}" if isinstance(board, Chessboard) else name] = value
    return keys


def load_board(path: str | Path) -> Board:
    """Read a board of any kind: dots without a `kind`, a target of Kalibr in a .yaml file.

    With `screen = true` the board is shown on a monitor: `pixel_pitch_mm` is the pitch of its pixels, and all lengths
    are given in pixels (`square_px` in place of `square_mm`).

    Raises:
        BadInputError: the file is missing or breaks the format of `save_board`, or its features cannot be
            distinguished; the sentence has the key.
    """
    if Path(path).suffix.lower() in _KALIBR_SUFFIXES:
        return board_of_table(_kalibr_target(Path(path)))
    return board_of_table(read_toml(path))


def _kalibr_target(path: Path) -> Table:
    """Return the keys of board.toml for a target of Kalibr: borders of two bits, numbers of inner corners.

    Raises:
        BadInputError: the file is not a target of Kalibr, or the target's kind is not one of `KINDS`.
    """
    kind, remedy = "a target of Kalibr", "write board.toml"
    stated = read_mapping(path, read_text(path, kind, remedy=remedy), kind, remedy)
    # YAML takes 88e-3 for text.
    numbers = {key: float(value) for key, value in stated.items() if isinstance(value, str) and is_number(value)}
    table = Table(stated | numbers, str(path))
    target = table.text("target_type", choices=_KALIBR_TARGETS)
    keys: dict[str, Any]
    if target == "aprilgrid":
        keys = {"kind": "april-grid", "tag_columns": table.whole("tagCols", 1), "tag_rows": table.whole("tagRows", 1)}
        keys |= {"tag_mm": 1e3 * table.number("tagSize"), "spacing": table.number("tagSpacing")}
        keys |= {"first_id": table.whole("codeOffset")} if table.has("codeOffset") else {}
    elif target == "checkerboard":
        squares = table.number("colSpacingMeters"), table.number("rowSpacingMeters")
        if squares[0] != squares[1]:
            raise table.fail("'rowSpacingMeters' and 'colSpacingMeters' differ; boards here have square squares.")
        keys = {
            "kind": "chessboard",
            "corner_columns": table.whole("targetCols"),
            "corner_rows": table.whole("targetRows"),
        }
        keys |= {"square_mm": 1e3 * squares[0]}
    else:
        raise table.fail(
            "a circlegrid of Kalibr has no diameter of the circles, which is needed here; write board.toml with kind = "
            '"circles" or "asymmetric-circles".'
        )
    table.finish()
    return Table(keys, str(path))


def board_of_table(table: Table) -> Board:
    """Return the board that the keys of a table describe; see `load_board`.

    Raises:
        BadInputError: as `load_board`.
    """
    kind = table.text("kind", "dots", choices=KINDS)
    lengths = _Lengths.of(table)
    tolerances = _tolerances(table)
    board: Board
    if kind == "dots":
        board = _dot_board(table, lengths, tolerances)
    elif kind == "charuco":
        board = _charuco(table, lengths, tolerances)
    elif kind == "april-grid":
        board = _april_grid(table, lengths, tolerances)
    elif kind == "chessboard":
        board = _chessboard(table, lengths, tolerances)
    else:
        board = _circles(table, lengths, tolerances, staggered=kind == "asymmetric-circles")
    table.finish()
    return board


@dataclass(frozen=True)
class _Lengths:
    """Reader of lengths of a file, in metres: from millimetres, or from pixels of a monitor."""

    table: Table
    unit: str
    unit_m: float

    @classmethod
    def of(cls, table: Table) -> "_Lengths":
        if not table.flag("screen", False):
            return cls(table, "mm", 1e-3)
        return cls(table, "px", 1e-3 * table.number("pixel_pitch_mm", above=0, most=_LARGEST_PITCH_MM))

    def key(self, name: str) -> str:
        return f"{name}_{self.unit}"

    def number(self, name: str, default_m: float | None = None) -> float:
        """Return a length; it may be 0 only where there is a default, as for margins."""
        least, most = (length / self.unit_m for length in _LENGTH_M)
        if default_m is None:
            return self.table.number(self.key(name), least=least, most=most) * self.unit_m
        return self.table.number(self.key(name), default_m / self.unit_m, 0, most) * self.unit_m


def _charuco(table: Table, lengths: _Lengths, tolerances: BoardTolerances) -> CharucoBoard:
    columns, rows = table.whole("square_columns", 2), table.whole("square_rows", 2)
    square, marker = lengths.number("square"), lengths.number("marker")
    if marker >= square:
        raise table.fail(
            f"'{lengths.key('marker')}' is not smaller than '{lengths.key('square')}'; give the side of the marker's "
            "black border."
        )
    dictionary, legacy = table.text("dictionary", choices=DICTIONARIES), table.flag("legacy", False)
    needed = (columns * rows + 1) // 2
    if needed > (available := len(dictionary_of(dictionary).bytesList)):
        raise table.fail(
            f"the board needs {needed} markers, but {dictionary} has {available}; is the dictionary right?"
        )
    margin = lengths.number("margin", 0.0)
    return CharucoBoard(columns, rows, square, marker, dictionary, legacy, margin, tolerances)


def _april_grid(table: Table, lengths: _Lengths, tolerances: BoardTolerances) -> AprilGrid:
    columns, rows, tag = table.whole("tag_columns", 1), table.whole("tag_rows", 1), lengths.number("tag")
    spacing = table.number("spacing", 0.3)
    if not 0 < spacing < 1:
        raise table.fail(f"'spacing' is {spacing:g}; it is the gap between tags over their side, between 0 and 1.")
    border, first = table.whole("border_bits", 1, 10, default=2), table.whole("first_id", default=0)
    available = len(dictionary_of(DICTIONARY).bytesList)
    if first + columns * rows > available:
        raise table.fail(
            f"the board needs tags up to {first + columns * rows - 1}, but 36h11 ends at {available - 1}; use fewer."
        )
    at_bottom = table.text("first_tag", _FIRST_TAGS[1], choices=_FIRST_TAGS) == _FIRST_TAGS[1]
    margin = lengths.number("margin", 0.0)
    return AprilGrid(columns, rows, tag, spacing, border, first, at_bottom, margin, tolerances)


def _chessboard(table: Table, lengths: _Lengths, tolerances: BoardTolerances) -> Chessboard:
    columns, rows = table.whole("corner_columns", 3, _MOST), table.whole("corner_rows", 3, _MOST)
    _check_count(table, columns, rows)
    if columns == rows:
        raise table.fail(
            f"a chessboard of {columns} x {rows} inner corners looks the same turned by 90 degrees; use one with "
            "different numbers, or a ChArUco board."
        )
    square = lengths.number("square")
    return Chessboard(columns, rows, square, lengths.number("margin", square), tolerances)


def _circles(table: Table, lengths: _Lengths, tolerances: BoardTolerances, staggered: bool) -> CircleGrid:
    columns, rows = table.whole("columns", 2, _MOST), table.whole("rows", 3, _MOST)
    _check_count(table, columns, rows)
    if not staggered and columns == rows:
        raise table.fail(
            f"a grid of {columns} x {rows} circles looks the same turned by 90 degrees; use one with different numbers."
        )
    pitch, diameter = lengths.number("pitch"), lengths.number("diameter")
    if diameter > 0.85 * pitch * (np.sqrt(2.0) if staggered else 1.0):
        raise table.fail(f"'{lengths.key('diameter')}' is so large that circles nearly touch; measure it again.")
    return CircleGrid(columns, rows, pitch, diameter, lengths.number("margin", pitch), staggered, tolerances)


def _dot_board(table: Table, lengths: _Lengths, tolerances: BoardTolerances) -> DotBoard:
    pitch_m, large_m, small_m, margin_m = (lengths.number(key) for key in ("pitch", "large", "small", "margin"))
    large = _sizes(table)
    for key, number in (("columns", large.shape[1]), ("rows", large.shape[0])):
        if table.number(key) != number:
            raise table.fail(f"'{key}' is {table.number(key):g}, but 'sizes' has {number} {key}; one is wrong.")
    with prefix_errors(table.where):
        check_sizes(pitch_m, large_m, small_m, margin_m)
    return DotBoard(pitch_m, large_m, small_m, margin_m, large, tolerances)


def _check_count(table: Table, columns: int, rows: int) -> None:
    if columns * rows > LIMITS.board_features:
        raise table.fail(
            f"the board has {columns} x {rows} features, more than {LIMITS.board_features}; correct their number."
        )


def _tolerances(table: Table) -> BoardTolerances:
    usual = BoardTolerances()
    return BoardTolerances(
        table.number("scale_sigma", usual.scale_sigma, 0, 0.5),
        1e-3 * table.number("flatness_mm", 1e3 * usual.flatness_m, 0, 100),
        1e-6 * table.number("print_error_um", round(1e6 * usual.print_error_m, 6), 0, 10_000),
    )


def _tolerance_keys(tolerances: BoardTolerances) -> dict[str, float]:
    return {
        "scale_sigma": tolerances.scale_sigma,
        "flatness_mm": _in_mm(tolerances.flatness_m),
        "print_error_um": round(1e6 * tolerances.print_error_m, 6),
    }


def _sizes(table: Table) -> BoolArray:
    rows = table.texts("sizes")
    _check_count(table, len(rows[0]), len(rows))
    if len({len(row) for row in rows}) != 1 or set("".join(rows)) - {"0", "1"} or not rows[0]:
        raise table.fail("'sizes' must be texts of equal length, one per row of dots, of 1 for large and 0 for small.")
    if len(set("".join(rows))) == 1:
        raise table.fail("'sizes' has dots of one size only, which tell no place on the board; write both, as printed.")
    return np.array([[digit == "1" for digit in row] for row in rows])


def _in_mm(length_m: float) -> float:
    """Return a length in millimetres, rounded to 1 nm; finer digits are meaningless for a print."""
    return round(1e3 * length_m, 9)
