"""Simulate the missing photographs of one camera pose."""

import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from wlr_render.captures.boards.board import Board
from wlr_render.captures.photographs import write_photograph
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.device import EyeOptics
from wlr_render.simulation.photographs.board_light import BoardLight, FarWall
from wlr_render.simulation.photographs.camera import Sensor, SimulatedLens
from wlr_render.simulation.photographs.camera_view import CameraView

_DARK_ROOM = FarWall(brightness=0.03)  # while the panel is photographed


@dataclass(frozen=True, eq=False)
class BoardShot:
    """A photograph of the board.

    Attributes:
        path: where it is written.
        frame_from_board: (4, 4) in the frame of its camera pose.
    """

    path: Path
    frame_from_board: FloatArray


class Pictures(Protocol):
    """Pictures that a panel shows one after the other: a `Pattern`, or any others."""

    def names(self) -> tuple[str, ...]:
        """What they show, in the order of showing."""

    def image(self, index: int) -> NDArray[np.uint8]:
        """(panel height, panel width) grey picture number `index`."""


@dataclass(frozen=True, eq=False)
class PanelShots:
    """Photographs of the panel, one for each picture shown.

    Attributes:
        folder: where they are written.
        pictures: what is shown.
    """

    folder: Path
    pictures: Pictures

    def paths(self) -> list[Path]:
        """In the order of showing."""
        names = [name.replace(" ", "_") for name in self.pictures.names()]
        return [self.folder / f"{number:03d}_{name}.png" for number, name in enumerate(names)]


@dataclass(frozen=True, eq=False)
class CameraPose:
    """A camera at one pose, and the photographs taken from there.

    Attributes:
        lens, sensor: the camera.
        frame_from_camera: (4, 4); the frame is the device's if `optics` are given.
        optics: what it looks through; None without the headset.
        board: the target.
        boards, panels: the photographs.
        seed: of the noise.
        eye: "left" or "right", so that both eyes do not get mirrored noise.
    """

    lens: SimulatedLens
    sensor: Sensor
    frame_from_camera: FloatArray
    optics: EyeOptics | None
    board: Board
    boards: Sequence[BoardShot] = field(default_factory=tuple)
    panels: Sequence[PanelShots] = field(default_factory=tuple)
    seed: int = 1
    eye: str = "right"

    def paths(self) -> list[Path]:
        """Of all photographs."""
        return [shot.path for shot in self.boards] + [path for shots in self.panels for path in shots.paths()]


def take(pose: CameraPose) -> int:
    """Take the photographs that are not there yet; returns how many."""
    missing = {path for path in pose.paths() if not path.is_file()}
    if not missing:
        return 0
    if pose.optics is None:
        view = CameraView.without_headset(pose.lens, pose.frame_from_camera)
    else:
        view = CameraView.through_optics(pose.optics, pose.lens, pose.frame_from_camera)
    for shot in pose.boards:
        if shot.path in missing:
            light = view.world_light(BoardLight(pose.board, shot.frame_from_board))
            write_photograph(shot.path, pose.sensor.expose(light, _noise(pose, shot.path)))
    for shots in pose.panels:
        dark = view.world_light(_DARK_ROOM)
        for number, path in enumerate(shots.paths()):
            if path in missing:
                light = view.panel_light(shots.pictures.image(number)) + dark
                write_photograph(path, pose.sensor.expose(light, _noise(pose, path)))
    return len(missing)


def _noise(pose: CameraPose, path: Path) -> np.random.Generator:
    """The same for a photograph whenever and in whatever order it is taken."""
    return np.random.default_rng([pose.seed, zlib.crc32("/".join(path.parts[-2:]).encode()), int(pose.eye == "left")])
