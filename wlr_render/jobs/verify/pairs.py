"""Measure the misalignment in a lab's photographs, display off and on, from the same position."""

import re
from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import Annotated

from wlr_render.calibration.bench.station_file import load_station
from wlr_render.captures.boards.board_file import load_board
from wlr_render.captures.photographs import photographs_in
from wlr_render.errors import BadInputError
from wlr_render.jobs.job import job
from wlr_render.jobs.options import EyeName, Options, ProgressArgument, described
from wlr_render.jobs.verify.misalignment_tables import Judged, PairPosition, judge_pair, misalignment_report
from wlr_render.progress import SILENT
from wlr_render.report.blocks import Report

_OFF = re.compile(r"(?P<name>.+)_off")
_ON = re.compile(r"(?P<name>.+)_on(_(?P<method>.+))?")


@dataclass(frozen=True)
class VerifyPairsOptions(Options):
    """Options of `verify pairs`."""

    photographs: Annotated[
        Path,
        described("Folder of photographs NAME_off.png, and NAME_on.png or NAME_on_METHOD.png from the same position."),
    ]
    board: Annotated[Path, described("File board.toml of the target in the photographs.")]
    _: KW_ONLY
    calibration: Annotated[Path, described("Output folder of `calibrate photos`, for the lens of the camera.")] = Path(
        "out/calibrate"
    )
    eye: Annotated[EyeName, described("Eye that the camera was calibrated for.")] = "right"
    out: Annotated[Path, described("Output folder.")] = Path("out/verify-pairs")


@job
def verify_pairs(options: VerifyPairsOptions, *, progress: ProgressArgument = SILENT) -> Report:
    """Measure how far drawn dots lie from real ones; writes pictures and the report into `options.out`.

    Raises:
        BadInputError: there is no pair, a photograph with the display on has none with it off, or a file is missing.
    """
    progress.say("finding dots")
    station = options.calibration / f"station-{options.eye}.json"
    judged = _judge_pairs(options.photographs, options.board, station)
    inputs = [options.photographs, options.board, station]
    return misalignment_report(judged, options.photographs.name, options.out, inputs, options)


def _judge_pairs(folder: Path, board_file: Path, station: Path) -> list[Judged]:
    """Judge NAME_off.png with every NAME_on.png or NAME_on_METHOD.png beside it."""
    photographs = photographs_in(folder)
    board, camera = load_board(board_file), load_station(station).eyeball_camera
    off = {match["name"]: path for path in photographs if (match := _OFF.fullmatch(path.stem))}
    judged = []
    for path in photographs:
        match = _ON.fullmatch(path.stem)
        if match is None or path in off.values():
            continue
        name, method = match["name"], match["method"] or "on"
        if name not in off:
            raise BadInputError(f"{path}: has no photograph with the display off beside it; name that {name}_off.png.")
        judged.append(judge_pair(PairPosition(name), method, (off[name], path), board, camera))
    if not judged:
        raise BadInputError(
            f"{folder}: holds no pairs of photographs named NAME_off.png and NAME_on.png; name them so."
        )
    return judged
