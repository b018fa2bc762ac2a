"""Pairs of photographs that a lab has taken of its own headset: the same judgement, without the drawing."""

import re
from pathlib import Path

from wlr_render.calibration.station_file import load_station
from wlr_render.captures.photographs import photographs_in
from wlr_render.captures.targets.board_file import load_board
from wlr_render.errors import BadInputError
from wlr_render.jobs.verify.judgement import Judged, Place, judge_pair

_OFF = re.compile(r"(?P<name>.+)_off")
_ON = re.compile(r"(?P<name>.+)_on(_(?P<method>.+))?")


def judge_pairs(folder: Path, board_file: Path, calibration: Path) -> list[Judged]:
    """Judge NAME_off.png with every NAME_on.png or NAME_on_METHOD.png beside it.

    Args:
        folder: of the photographs.
        board_file: the target's board.toml.
        calibration: folder of `calibrate`'s results, for the camera's lens in station.json.

    Raises:
        BadInputError: there is no pair, a photograph with the display on has none with it off, or a file is missing.
    """
    board, camera = load_board(board_file), load_station(calibration / "station.json").eyeball_camera
    photographs = photographs_in(folder)
    off = {match["name"]: path for path in photographs if (match := _OFF.fullmatch(path.stem))}
    judged = []
    for path in photographs:
        match = _ON.fullmatch(path.stem)
        if match is None or path in off.values():
            continue
        name, method = match["name"], match["method"] or "on"
        if name not in off:
            raise BadInputError(f"{path}: has no photograph with the display off beside it; name that {name}_off.png.")
        judged.append(judge_pair(Place(name), method, (off[name], path), board, camera))
    if not judged:
        raise BadInputError(f"{folder}: holds no pairs of photographs named NAME_off.png and NAME_on.png.")
    return judged
