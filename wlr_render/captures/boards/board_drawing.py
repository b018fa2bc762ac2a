"""Drawings of boards for printing: SVG in exact millimetres, and PNG.

Both drawings have a ruler, because printers scale: its measured length over the length written next to it is the scale
of the print.
"""

import io
from dataclasses import dataclass
from pathlib import Path
from xml.sax.saxutils import escape

import numpy as np
from numpy.typing import NDArray

from wlr_render.captures.boards.board import Board
from wlr_render.errors import BadInputError
from wlr_render.io.atomic_files import write_bytes, write_text

_STRIP_MM = 12.0  # height of the strip below the board, for ruler and text
_EDGE_MM = 5.0  # distance of the ruler from the sheet's left edge
_RULER_TEXT_MM = 20.0  # width of the text to the right of the ruler
_LEAST_WIDTH_MM = 50.0  # least width of the sheet, for the ruler and text of a tiny board
_TICK_MM = 3.0  # length of the ruler's ticks
_LINE_MM = 0.2  # width of lines, which any printer can draw
_TEXT_MM = 3.0  # height of text, readable at arm's length
_MM_PER_INCH = 25.4
_MOST_PIXELS = 400_000_000  # most pixels of a PNG: a sheet of A0 at 500 dots per inch


@dataclass(frozen=True)
class _Sheet:
    """Layout of the sheet, millimetres from its top left corner.

    Attributes:
        width, height: size of the sheet: the board at its top left, a strip below.
        ruler: length of the ruler, whole centimetres.
        ruler_y: y of the ruler's line.
    """

    width: float
    height: float
    ruler: float
    ruler_y: float


def write_board_svg(board: Board, path: str | Path) -> Path:
    """Draw a board as SVG with a user unit of one millimetre, to be printed at 100 %."""
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
        f"<title>{escape(board.title)}</title>",
        '<rect width="100%" height="100%" fill="white"/>',
        *board.svg_shapes(),
        f'<path d="M {_EDGE_MM} {sheet.ruler_y:.4f} h {sheet.ruler:.4f} {ticks}" stroke="black" '
        f'stroke-width="{_LINE_MM}" fill="none"/>',
        f'<text x="{end + 2:.4f}" y="{sheet.ruler_y + 1:.4f}" font-size="{_TEXT_MM}" font-family="sans-serif">'
        f"{sheet.ruler:g} mm</text>",
        f'<text x="{_EDGE_MM}" y="{sheet.height - 1.5:.4f}" font-size="{_text_mm(sheet, board):.4f}" '
        f'font-family="sans-serif">{escape(board.title)}</text>',
        "</svg>",
    ]
    return write_text(path, "\n".join(lines) + "\n")


def write_board_png(board: Board, path: str | Path, dots_per_inch: float = 600.0) -> Path:
    """Draw a board as a grey PNG that states its resolution; edges of dots are antialiased.

    Raises:
        BadInputError: the smallest shapes would have under 10 pixels, or the picture would be too large to handle.
    """
    from PIL import Image, ImageDraw, ImageFont

    sheet, pixels_per_mm = _sheet(board), dots_per_inch / _MM_PER_INCH
    width, height = (max(1, round(length * pixels_per_mm)) for length in (sheet.width, sheet.height))
    if 1e3 * board.finest_m * pixels_per_mm < 10.0 or width * height > _MOST_PIXELS:
        raise BadInputError(
            f"{path}: at {dots_per_inch:g} dots per inch the board has {width} x {height} pixels and its smallest "
            f"shapes are {1e3 * board.finest_m * pixels_per_mm:.1f} pixels wide; choose another "
            "resolution, or print the SVG."
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
    # A font's size is its line height; Pillow's bundled font is always available.
    font = ImageFont.load_default(_TEXT_MM * pixels_per_mm)
    draw.text(at(end + 2, sheet.ruler_y - 0.6 * _TEXT_MM), f"{sheet.ruler:g} mm", 0, font)
    small = ImageFont.load_default(_text_mm(sheet, board) * pixels_per_mm)
    draw.text(at(_EDGE_MM, sheet.height - 1.5 - _text_mm(sheet, board)), board.title, 0, small)
    content = io.BytesIO()
    picture.save(content, format="PNG", dpi=(dots_per_inch, dots_per_inch))
    return write_bytes(path, content.getbuffer())


def _sheet(board: Board) -> _Sheet:
    width, height = (float(length) for length in 1e3 * board.size_m)
    width = max(width, _LEAST_WIDTH_MM)
    ruler = 10.0 * ((width - _EDGE_MM - _RULER_TEXT_MM) // 10.0)
    return _Sheet(width, height + _STRIP_MM, ruler, height + 0.3 * _STRIP_MM)


def _text_mm(sheet: _Sheet, board: Board) -> float:
    """Return the height of letters with which the title fits the width; letters are about half as wide as high."""
    return min(_TEXT_MM, (sheet.width - 2 * _EDGE_MM) / (0.55 * len(board.title)))


def _raster(board: Board, width: int, height: int, pixel_mm: float) -> NDArray[np.uint8]:
    """Return the picture (h, w) of the board with white below it, computed in strips of rows to save memory."""
    picture = np.empty((height, width), np.uint8)
    x = 1e-3 * pixel_mm * (np.arange(width) + 0.5) - 0.5 * board.size_m[0]
    for top in range(0, height, 256):
        y = 1e-3 * pixel_mm * (np.arange(top, min(top + 256, height)) + 0.5) - 0.5 * board.size_m[1]
        light = board.reflectance(np.stack(np.meshgrid(x, y), axis=-1), 1e-3 * pixel_mm)
        picture[top : top + 256] = np.rint(255.0 * np.nan_to_num(light, nan=1.0))
    return picture
