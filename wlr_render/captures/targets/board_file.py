"""Board files: board.toml with the design, and SVG in exact millimetres and PNG for printing.

Both drawings carry a ruler, since printers scale: what its ends measure, over what is written beside it, is the scale
of the print.
"""

import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wlr_render.captures.targets.board_design import check_sizes
from wlr_render.captures.targets.dot_board import DotBoard
from wlr_render.errors import BadInputError
from wlr_render.files import write_bytes, write_text
from wlr_render.numerics.arrays import BoolArray
from wlr_render.toml_files import Table, read_toml, write_toml

_STRIP_MM = 12.0  # below the board, for ruler and text
_EDGE_MM = 5.0  # from the left edge to the ruler
_RULER_TEXT_MM = 20.0  # to the right of the ruler
_LEAST_WIDTH_MM = 50.0  # of the sheet, for the ruler and text of a tiny board
_TICK_MM = 3.0
_LINE_MM = 0.2
_TEXT_MM = 3.0
_MM_PER_INCH = 25.4
_MOST_PIXELS = 400_000_000
_COMMENT = """A board of large and small dots on a square grid. Lengths are millimetres as measured on the print:
where the printer scaled it, measure the ruler and multiply all four by measured / written.
sizes: one text per row of dots, from the top; 1 large, 0 small."""


@dataclass(frozen=True)
class _Sheet:
    """Where things lie on the sheet, millimetres from its top left corner.

    Attributes:
        width, height: of the sheet: the board at its top left, a strip below.
        ruler: length of the ruler, whole centimetres.
        ruler_y: height of its line.
    """

    width: float
    height: float
    ruler: float
    ruler_y: float


def save_board(board: DotBoard, path: str | Path) -> Path:
    """Write a board as TOML, so that `load_board` gives the same one back."""
    table = {
        "columns": board.columns,
        "rows": board.rows,
        "pitch_mm": _in_mm(board.pitch_m),
        "large_mm": _in_mm(board.large_m),
        "small_mm": _in_mm(board.small_m),
        "margin_mm": _in_mm(board.margin_m),
        "sizes": ["".join("1" if large else "0" for large in row) for row in board.large],
    }
    return write_toml(path, table, _COMMENT)


def load_board(path: str | Path) -> DotBoard:
    """Read a board.

    Raises:
        BadInputError: the file is missing or not as `save_board` writes it, or its dots cannot be distinguished; the
            sentence has the key.
    """
    table = read_toml(path)
    pitch_m, large_m, small_m, margin_m = (
        1e-3 * table.number(key) for key in ("pitch_mm", "large_mm", "small_mm", "margin_mm")
    )
    large = _sizes(table)
    for key, number in (("columns", large.shape[1]), ("rows", large.shape[0])):
        if table.number(key) != number:
            raise table.fail(f"'{key}' is {table.number(key):g}, but 'sizes' has {number} {key}; one is wrong.")
    table.finish()
    try:
        check_sizes(pitch_m, large_m, small_m, margin_m)
    except BadInputError as error:
        raise table.fail(str(error)) from error
    return DotBoard(pitch_m, large_m, small_m, margin_m, large)


def _sizes(table: Table) -> BoolArray:
    rows = table.texts("sizes")
    if len({len(row) for row in rows}) != 1 or set("".join(rows)) - {"0", "1"} or not rows[0]:
        raise table.fail("'sizes' must be texts of equal length, one per row of dots, of 1 for large and 0 for small.")
    return np.array([[digit == "1" for digit in row] for row in rows])


def _in_mm(length_m: float) -> float:
    """Millimetres as a person would write them; a thousandth of a micrometre is no news of a print."""
    return round(1e3 * length_m, 9)


def write_board_svg(board: DotBoard, path: str | Path) -> Path:
    """Draw a board as SVG, one user unit a millimetre; print it at 100 %.

    Large dots have the class "large", small ones "small".
    """
    sheet = _sheet(board)
    size = (
        f'width="{sheet.width:.4f}mm" height="{sheet.height:.4f}mm" viewBox="0 0 {sheet.width:.4f} {sheet.height:.4f}"'
    )
    end = _EDGE_MM + sheet.ruler
    ticks = " ".join(
        f"M {x:.4f} {sheet.ruler_y - 0.5 * _TICK_MM:.4f} v {_TICK_MM}" for x in (_EDGE_MM, _EDGE_MM + sheet.ruler)
    )
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        f'<svg xmlns="http://www.w3.org/2000/svg" {size}>',
        f"<title>{_title(board)}</title>",
        '<rect width="100%" height="100%" fill="white"/>',
        *_circles(board),
        f'<path d="M {_EDGE_MM} {sheet.ruler_y:.4f} h {sheet.ruler:.4f} {ticks}" stroke="black" '
        f'stroke-width="{_LINE_MM}" fill="none"/>',
        f'<text x="{end + 2:.4f}" y="{sheet.ruler_y + 1:.4f}" font-size="{_TEXT_MM}" font-family="sans-serif">'
        f"{sheet.ruler:g} mm</text>",
        f'<text x="{_EDGE_MM}" y="{sheet.height - 1.5:.4f}" font-size="{_text_mm(sheet, board):.4f}" '
        f'font-family="sans-serif">{_title(board)}</text>',
        "</svg>",
    ]
    return write_text(path, "\n".join(lines) + "\n")


def write_board_png(board: DotBoard, path: str | Path, dots_per_inch: float = 600.0) -> Path:
    """Draw a board as a grey PNG with its resolution in it; edges of dots are antialiased.

    Raises:
        BadInputError: small dots would have under 10 pixels, or the picture would be too large to handle.
    """
    from PIL import Image, ImageDraw, ImageFont

    sheet, pixels_per_mm = _sheet(board), dots_per_inch / _MM_PER_INCH
    width, height = (max(1, round(length * pixels_per_mm)) for length in (sheet.width, sheet.height))
    if 1e3 * board.small_m * pixels_per_mm < 10.0 or width * height > _MOST_PIXELS:
        raise BadInputError(
            f"{path}: at {dots_per_inch:g} dots per inch the board has {width} x {height} pixels and small dots "
            f"{1e3 * board.small_m * pixels_per_mm:.1f} pixels wide; choose another resolution, or print the SVG."
        )
    picture = Image.fromarray(_raster(board, width, height, 1.0 / pixels_per_mm))
    draw = ImageDraw.Draw(picture)

    def at(x_mm: float, y_mm: float) -> tuple[float, float]:
        return x_mm * pixels_per_mm, y_mm * pixels_per_mm

    half, end = 0.5 * _TICK_MM, _EDGE_MM + sheet.ruler
    line = max(1, round(_LINE_MM * pixels_per_mm))
    draw.line([at(_EDGE_MM, sheet.ruler_y), at(end, sheet.ruler_y)], 0, line)
    for x in (_EDGE_MM, end):
        draw.line([at(x, sheet.ruler_y - half), at(x, sheet.ruler_y + half)], 0, line)
    # A font's size is its height from line to line; Pillow's own font always comes with it.
    font = ImageFont.load_default(_TEXT_MM * pixels_per_mm)
    draw.text(at(end + 2, sheet.ruler_y - 0.6 * _TEXT_MM), f"{sheet.ruler:g} mm", 0, font)
    small = ImageFont.load_default(_text_mm(sheet, board) * pixels_per_mm)
    draw.text(at(_EDGE_MM, sheet.height - 1.5 - _text_mm(sheet, board)), _title(board), 0, small)
    content = io.BytesIO()
    picture.save(content, format="PNG", dpi=(dots_per_inch, dots_per_inch))
    return write_bytes(path, content.getbuffer())


def _sheet(board: DotBoard) -> _Sheet:
    width, height = (float(length) for length in 1e3 * board.size_m)
    width = max(width, _LEAST_WIDTH_MM)
    ruler = 10.0 * ((width - _EDGE_MM - _RULER_TEXT_MM) // 10.0)
    return _Sheet(width, height + _STRIP_MM, ruler, height + 0.3 * _STRIP_MM)


def _title(board: DotBoard) -> str:
    return (
        f"two-size dot board {board.columns} x {board.rows}, pitch {1e3 * board.pitch_m:g} mm, "
        f"dots {1e3 * board.large_m:g} and {1e3 * board.small_m:g} mm, margin {1e3 * board.margin_m:g} mm"
    )


def _text_mm(sheet: _Sheet, board: DotBoard) -> float:
    """Height of the title's letters, so that it fits the width; letters are about half as wide as high."""
    return min(_TEXT_MM, (sheet.width - 2 * _EDGE_MM) / (0.55 * len(_title(board))))


def _circles(board: DotBoard) -> list[str]:
    index = board.indices()
    centre_mm = 1e3 * (board.point_of(index)[:, :2] + 0.5 * board.size_m)
    return [
        f'<circle class="{"large" if diameter == board.large_m else "small"}" '
        f'cx="{x:.4f}" cy="{y:.4f}" r="{500.0 * diameter:.4f}"/>'
        for (x, y), diameter in zip(centre_mm, board.diameter_of(index), strict=True)
    ]


def _raster(board: DotBoard, width: int, height: int, pixel_mm: float) -> NDArray[np.uint8]:
    """(h, w) the board and white below it, a strip of rows at a time to save memory."""
    picture = np.empty((height, width), np.uint8)
    x = 1e-3 * pixel_mm * (np.arange(width) + 0.5) - 0.5 * board.size_m[0]
    for top in range(0, height, 256):
        y = 1e-3 * pixel_mm * (np.arange(top, min(top + 256, height)) + 0.5) - 0.5 * board.size_m[1]
        light = board.reflectance(np.stack(np.meshgrid(x, y), axis=-1), 1e-3 * pixel_mm)
        picture[top : top + 256] = np.rint(255.0 * np.nan_to_num(light, nan=1.0))
    return picture
