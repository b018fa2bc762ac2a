"""What a lab prints and shows: dot boards, and the pictures of panel codes."""

from pathlib import Path

from wlr_render.captures.patterns.catalogue import make_pattern
from wlr_render.captures.patterns.show_page import PAGE, write_show_page
from wlr_render.captures.targets.board_design import design_board
from wlr_render.captures.targets.board_file import save_board, write_board_png, write_board_svg
from wlr_render.files import output_folder
from wlr_render.mappings import Panel


def write_board(
    folder: str | Path, columns: int, rows: int, pitch_m: float, dots_per_inch: int = 200, seed: int = 1
) -> tuple[Path, ...]:
    """Write a board as board.svg and board.png, to be printed, and board.toml, for the session's folder.

    Raises:
        BadInputError: no such board can be made.
    """
    board = design_board(columns, rows, pitch_m, seed=seed)
    into = output_folder(folder)
    picture = write_board_png(board, into / "board.png", dots_per_inch)  # first, as it alone may be refused
    return write_board_svg(board, into / "board.svg"), picture, save_board(board, into / "board.toml")


def write_pattern(folder: str | Path, panel_px: tuple[int, int], name: str) -> tuple[int, Path]:
    """Write the pictures of a code and the page that shows them; returns how many there are, and the page.

    Raises:
        BadInputError: no such code can be made.
    """
    pattern = make_pattern(name, Panel(*panel_px))
    pictures = write_show_page(output_folder(folder), pattern)
    return len(pictures), pictures[0].parent / PAGE
