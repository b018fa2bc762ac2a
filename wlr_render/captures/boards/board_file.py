"""Board files: board.toml with the design of a board of any kind and the tolerances of its print.

Kalibr's target files are read, too.
"""

from pathlib import Path
from typing import Any

import numpy as np

from wlr_render.captures.boards.april_grid import DICTIONARY, AprilGrid
from wlr_render.captures.boards.board import Board, BoardTolerances
from wlr_render.captures.boards.board_design import check_sizes
from wlr_render.captures.boards.board_keys import MARGIN, BoardLength, BoardPlace
from wlr_render.captures.boards.charuco import CharucoBoard
from wlr_render.captures.boards.chessboard import Chessboard
from wlr_render.captures.boards.circle_grid import CircleGrid
from wlr_render.captures.boards.dot_board import DotBoard
from wlr_render.captures.boards.markers import dictionary_of
from wlr_render.captures.plain_data import read_mapping
from wlr_render.io.delimited_text import is_number
from wlr_render.io.file_records import MM, read_part, read_record, record_keys
from wlr_render.io.input_files import LIMITS, prefix_errors, read_text
from wlr_render.io.toml_files import Table, read_toml, write_toml

KINDS = ("dots", "charuco", "april-grid", "chessboard", "circles", "asymmetric-circles")
"""Kinds of boards: the values of `kind` in board files."""

_LARGEST_PITCH_MM = 50.0  # largest pixel pitch of a screen; a video wall has a tenth of it
_LARGEST_CIRCLE = 0.85  # largest ratio of a circle's diameter to the distance of the nearest circle
_PITCHES = {"chessboard": "square", "circles": "pitch", "asymmetric-circles": "pitch"}  # default margins by kind

_COMMENT = """A calibration board. Lengths are millimetres as measured on the print:
where the printer scaled it, measure the ruler and multiply all of them by measured / written.
scale_sigma, flatness_mm, print_error_um: standard deviations of how far the print may differ from this design."""
_DOTS_COMMENT = "\nsizes: one text per row of dots, from the top; 1 large, 0 small."
_KALIBR_SUFFIXES = (".yaml", ".yml")
_KALIBR_TARGETS = ("aprilgrid", "checkerboard", "circlegrid")
_CLASSES = (DotBoard, CharucoBoard, AprilGrid, Chessboard, CircleGrid)  # classes in the order of KINDS


def save_board(board: Board, path: str | Path) -> Path:
    """Write a board as TOML that `load_board` reads back."""
    return write_toml(path, board_table(board), _COMMENT + (_DOTS_COMMENT if isinstance(board, DotBoard) else ""))


def board_table(board: Board) -> dict[str, Any]:
    """Return the keys and values of a board file, with lengths in millimetres.

    Raises:
        TypeError: boards of this class have no file format.
    """
    if not isinstance(board, _CLASSES):
        raise TypeError(f"a {type(board).__name__} has no board file")
    kind = KINDS[_CLASSES.index(type(board))]
    if isinstance(board, CircleGrid) and board.staggered:
        kind = KINDS[-1]
    counts = {"columns": board.columns, "rows": board.rows} if isinstance(board, DotBoard) else {}
    keys = record_keys(board, BoardPlace(), defaults=True) | record_keys(board.tolerances, defaults=True)
    return {"kind": kind} | counts | keys


def load_board(path: str | Path) -> Board:
    """Read a board of any kind: a dot board if the file has no `kind`, a target of Kalibr if it is a .yaml file.

    With `screen = true` the board is shown on a monitor: `pixel_pitch_mm` is the pitch of its pixels, and all lengths
    are given in pixels (`square_px` in place of `square_mm`).

    Raises:
        BadInputError: the file is missing or breaks the format of `save_board`, or its features cannot be
            distinguished; the message has the key.
    """
    if Path(path).suffix.lower() in _KALIBR_SUFFIXES:
        return board_of_table(_kalibr_target(Path(path)))
    return board_of_table(read_toml(path))


def _kalibr_target(path: Path) -> Table:
    """Return the keys of board.toml for a target of Kalibr, with tag borders of two bits and numbers of inner corners.

    Raises:
        BadInputError: the file is not a target of Kalibr, or the target's kind is not one of `KINDS`.
    """
    kind, remedy = "a target of Kalibr", "write board.toml"
    stated = read_mapping(path, read_text(path, kind, remedy=remedy), kind, remedy)
    # YAML parses 88e-3 as text.
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
    place = BoardPlace()
    if table.flag("screen", False):
        place = BoardPlace(unit="px", unit_m=MM * table.number("pixel_pitch_mm", above=0, most=_LARGEST_PITCH_MM))
    given: dict[str, Any] = {"tolerances": read_part(BoardTolerances, table)}
    if kind in _PITCHES and not any(map(table.has, MARGIN.names)):
        given["margin_m"] = BoardLength(_PITCHES[kind]).read(table, place)
    if kind in KINDS[-2:]:
        given["staggered"] = kind == KINDS[-1]
    counts = [(key, table.number(key)) for key in ("columns", "rows")] if kind == "dots" else []
    board: Board = read_record(_CLASSES[min(KINDS.index(kind), len(_CLASSES) - 1)], table, place, **given)
    if isinstance(board, DotBoard):
        for key, count in counts:
            if (stated := getattr(board, key)) != count:
                raise table.fail(f"'{key}' is {count:g}, but 'sizes' has {stated} {key}; one is wrong.")
        with prefix_errors(table.where):
            check_sizes(board.pitch_m, board.large_m, board.small_m, board.margin_m)
    if fault := _fault(board, place.unit):
        raise table.fail(fault)
    return board


def _fault(board: Board, unit: str) -> str:
    """Describe the fault of a board whose keys are valid one by one, with the remedy; "" for a sound board."""
    if isinstance(board, DotBoard | Chessboard | CircleGrid):
        size = f"{board.columns} x {board.rows}"
        if board.columns * board.rows > LIMITS.board_features:
            return f"the board has {size} features, more than {LIMITS.board_features}; correct their number."
    match board:
        case CharucoBoard():
            needed = (board.square_columns * board.square_rows + 1) // 2
            if board.marker_m >= board.square_m:
                return (
                    f"'marker_{unit}' is not smaller than 'square_{unit}'; give the side of the marker's black border."
                )
            if needed > (available := len(dictionary_of(board.dictionary).bytesList)):
                counts = f"the board needs {needed} markers, but {board.dictionary} has {available}"
                return f"{counts}; is the dictionary right?"
        case AprilGrid():
            available = len(dictionary_of(DICTIONARY).bytesList)
            if (end := board.first_id + board.tag_columns * board.tag_rows) > available:
                return f"the board needs tags up to {end - 1}, but 36h11 ends at {available - 1}; use fewer."
        case Chessboard() if board.columns == board.rows:
            return (
                f"a chessboard of {size} inner corners looks the same turned by 90 degrees; use one with different "
                "numbers, or a ChArUco board."
            )
        case CircleGrid():
            if not board.staggered and board.columns == board.rows:
                return f"a grid of {size} circles looks the same turned by 90 degrees; use one with different numbers."
            if board.diameter_m > _LARGEST_CIRCLE * board.pitch_m * (np.sqrt(2.0) if board.staggered else 1.0):
                return f"'diameter_{unit}' is so large that circles nearly touch; measure it again."
    return ""
