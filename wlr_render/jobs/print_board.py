"""Write calibration boards for printing."""

from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from wlr_render.captures.boards.board import Board
from wlr_render.captures.boards.board_design import design_board
from wlr_render.captures.boards.board_drawing import write_board_png, write_board_svg
from wlr_render.captures.boards.board_file import board_of_table, save_board
from wlr_render.io.atomic_files import output_folder
from wlr_render.io.toml_files import Table
from wlr_render.jobs.job import job
from wlr_render.jobs.options import OnlyWith, Options, ProgressArgument, Range, Seed, described
from wlr_render.report.blocks import Report
from wlr_render.work.progress import SILENT

Kind = Literal["dots", "charuco", "april-grid", "chessboard", "circles", "asymmetric-circles"]
_CHARUCO = OnlyWith("kind", ("charuco",))


@dataclass(frozen=True)
class BoardOptions(Options):
    """Options of `board`."""

    _: KW_ONLY
    kind: Annotated[Kind, described("Kind of board.")] = "dots"
    columns: Annotated[int, described("Columns of dots, squares, tags or circles."), Range(1, 1000)] = 36
    rows: Annotated[int, described("Rows of dots, squares, tags or circles."), Range(1, 1000)] = 24
    pitch_mm: Annotated[
        float, described("Distance of neighbouring dots, squares, tags or rows of circles in mm."), Range(0.1, 1000)
    ] = 20.0
    dictionary: Annotated[str, described("OpenCV's dictionary of the markers of a ChArUco board."), _CHARUCO] = (
        "DICT_5X5_1000"
    )
    dpi: Annotated[int, described("Resolution of the PNG in dots per inch."), Range(1, 10_000)] = 200
    seed: Seed = 1
    out: Annotated[Path, described("Output folder.")] = Path("out/board")

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check_product(100_000, "shapes", "columns", "rows")


@job
def board(options: BoardOptions = BoardOptions(), *, progress: ProgressArgument = SILENT) -> Report:
    """Write a board as board.svg and board.png, to be printed, and board.toml, for the session's folder.

    Raises:
        BadInputError: no such board can be made.
    """
    designed = _designed(options)
    folder = output_folder(options.out)
    picture = write_board_png(designed, folder / "board.png", options.dpi)  # first: only this file may be refused
    files = [write_board_svg(designed, folder / "board.svg"), picture, save_board(designed, folder / "board.toml")]
    advice = ["Print board.svg at its true size, and put board.toml into the session's folder."]
    return Report("Board", f"A {designed.title}.", advice, files=files, stem="")


def _designed(options: BoardOptions) -> Board:
    """Return the board with the usual proportions of its kind."""
    columns, rows, pitch = options.columns, options.rows, options.pitch_mm
    if options.kind == "dots":
        return design_board(columns, rows, 1e-3 * pitch, seed=options.seed)
    keys: dict[str, Any] = {"kind": options.kind, "margin_mm": 0.5 * pitch}
    if options.kind == "charuco":
        keys |= {"square_columns": columns, "square_rows": rows, "square_mm": pitch, "marker_mm": 0.75 * pitch}
        keys |= {"dictionary": options.dictionary}
    elif options.kind == "april-grid":
        keys |= {
            "tag_columns": columns,
            "tag_rows": rows,
            "tag_mm": pitch / 1.3,
            "spacing": 0.3,
            "margin_mm": 0.1 * pitch,
        }
    elif options.kind == "chessboard":
        keys |= {"corner_columns": columns - 1, "corner_rows": rows - 1, "square_mm": pitch}
    else:
        diameter = (0.8 if options.kind == "asymmetric-circles" else 0.5) * pitch
        keys |= {"columns": columns, "rows": rows, "pitch_mm": pitch, "diameter_mm": diameter, "margin_mm": pitch}
    return board_of_table(Table(keys, f"{options.kind} of {columns} x {rows}"))
