"""Write dot boards and pictures of panel codes for printing and showing."""

from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import Annotated, Literal

from wlr_render.captures.boards.board_design import design_board
from wlr_render.captures.boards.board_drawing import write_board_png, write_board_svg
from wlr_render.captures.boards.board_file import save_board
from wlr_render.captures.patterns.catalogue import make_pattern
from wlr_render.captures.patterns.show_page import PAGE, write_show_page
from wlr_render.files import output_folder
from wlr_render.jobs.options import Options, ProgressArgument, Range, Seed, described, described_size
from wlr_render.mappings import Panel
from wlr_render.progress import SILENT
from wlr_render.report.blocks import Report

Code = Literal["gray", "fringes", "gray-fringes"]
Primary = Annotated[
    Literal["red", "green", "blue"] | None, described("Primary to show the code in (default: white, all of them).")
]


@dataclass(frozen=True)
class BoardOptions(Options):
    """Options of `board`."""

    _: KW_ONLY
    columns: Annotated[int, described("Columns of dots."), Range(at_least=1)] = 36
    rows: Annotated[int, described("Rows of dots."), Range(at_least=1)] = 24
    pitch_mm: Annotated[float, described("Distance of neighbouring dots in mm."), Range(at_least=0)] = 20.0
    dpi: Annotated[int, described("Resolution of the PNG in dots per inch."), Range(at_least=1)] = 200
    seed: Seed = 1
    out: Annotated[Path, described("Output folder.")] = Path("out/board")


def board(options: BoardOptions = BoardOptions(), *, progress: ProgressArgument = SILENT) -> Report:
    """Write a board as board.svg and board.png, to be printed, and board.toml, for the session's folder.

    Raises:
        BadInputError: no such board can be made.
    """
    designed = design_board(options.columns, options.rows, 1e-3 * options.pitch_mm, seed=options.seed)
    folder = output_folder(options.out)
    picture = write_board_png(designed, folder / "board.png", options.dpi)  # first, as it alone may be refused
    files = [write_board_svg(designed, folder / "board.svg"), picture, save_board(designed, folder / "board.toml")]
    advice = ["Print board.svg at its true size, and put board.toml into the session's folder."]
    return Report("Board", f"A board of {options.columns} x {options.rows} dots.", advice, files=files)


@dataclass(frozen=True)
class PatternOptions(Options):
    """Options of `pattern`."""

    _: KW_ONLY
    panel: Annotated[tuple[int, int], described_size("Pixels of the panel, e.g. 1920x1080."), Range(at_least=1)]
    pattern: Annotated[Code, described("Code to show.")] = "gray-fringes"
    channel: Primary = None
    out: Annotated[Path, described("Output folder.")] = Path("out/pattern")


def pattern(options: PatternOptions, *, progress: ProgressArgument = SILENT) -> Report:
    """Write the pictures of a code and the page that shows them full screen, one picture pixel on one panel pixel.

    Raises:
        BadInputError: no such code can be made.
    """
    code = make_pattern(options.pattern, Panel(*options.panel))
    pictures = write_show_page(output_folder(options.out), code, options.channel)
    page = options.out / PAGE
    advice = [f"Open {page} on the panel's screen to show them."]
    return Report("Pattern", f"{len(pictures)} pictures of the code {options.pattern}.", advice, files=[page])
