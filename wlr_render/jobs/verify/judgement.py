"""Two photographs from one place, display off and on, and how far their dots differ."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wlr_render.captures.photographs import read_photograph
from wlr_render.captures.targets.dot_board import DotBoard
from wlr_render.captures.targets.find_board import find_board
from wlr_render.errors import BadInputError
from wlr_render.evaluation.photograph_pair import PairMisalignment, pair_misalignment
from wlr_render.geometry.lens_camera import LensCamera


@dataclass(frozen=True)
class Place:
    """From where a pair was photographed.

    Attributes:
        name: in words.
        depth_m: of the target, where it is known.
        viewpoint: number of the camera's place, where it is known.
    """

    name: str
    depth_m: float | None = None
    viewpoint: int | None = None


@dataclass(frozen=True, eq=False)
class Judged:
    """One place and way of drawing.

    Attributes:
        place: from where.
        method: how the picture was drawn that the display showed.
        off, on: the photographs.
        misalignment: of their dots; None where one of them shows too little.
        complaint: why not, else empty.
    """

    place: Place
    method: str
    off: Path
    on: Path
    misalignment: PairMisalignment | None
    complaint: str = ""


def judge_pair(
    place: Place,
    method: str,
    photographs: tuple[Path, Path],
    board: DotBoard,
    camera: LensCamera,
    shown: NDArray[np.bool_] | None = None,
) -> Judged:
    """Match the dots of two photographs.

    Args:
        place: from where they were taken.
        method: of drawing.
        photographs: with the display off, and on.
        board: the target.
        camera: that took them.
        shown: (rows, columns) which dots the panel can show whole; None for all.
    """
    off, on = photographs
    try:
        real, virtual = (find_board(read_photograph(path), board, path.name) for path in photographs)
    except BadInputError as error:
        return Judged(place, method, off, on, None, str(error))
    if shown is not None:
        virtual = virtual.only(shown[virtual.index[:, 1], virtual.index[:, 0]])
    return Judged(place, method, off, on, pair_misalignment(real, virtual, camera))
