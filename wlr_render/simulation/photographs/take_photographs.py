"""Simulate the missing photographs of one camera pose."""

import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from wlr_render.captures.boards.board import Board
from wlr_render.captures.photographs import write_photograph
from wlr_render.numerics.arrays import Float32Array, FloatArray
from wlr_render.optics.device import EyeOptics
from wlr_render.simulation.photographs.board_light import BoardLight, FarWall
from wlr_render.simulation.photographs.camera import Sensor, SimulatedLens
from wlr_render.simulation.photographs.camera_view import CameraView
from wlr_render.simulation.photographs.printed_board import PrintedBoard

_SMALL_PX = 64  # side of the small copy for glare, which has no finer structure
_SPREAD = 0.1  # standard deviation of veiling glare, in sides of the picture
_WIDEST_STEP_PX2 = 0.25  # largest variance of a 3 x 3 kernel without much ringing
_DARK_ROOM = FarWall(brightness=0.03)  # background while the panel is photographed


@dataclass(frozen=True, eq=False)
class BoardShot:
    """A photograph of the board.

    Attributes:
        path: path of the photograph.
        frame_from_board: (4, 4) pose of the board in the frame of the camera pose.
    """

    path: Path
    frame_from_board: FloatArray


class Pictures(Protocol):
    """Pictures that a panel shows one after the other: a `Pattern`, or any other ones."""

    def names(self) -> tuple[str, ...]:
        """Return the names of the pictures, in the order of showing."""

    def image(self, index: int) -> NDArray[np.uint8]:
        """Return the grey picture number `index`, (panel height, panel width)."""


@dataclass(frozen=True, eq=False)
class PanelShots:
    """Photographs of the panel, one for each picture shown.

    Attributes:
        folder: folder of the photographs.
        pictures: pictures that the panel shows.
    """

    folder: Path
    pictures: Pictures

    def paths(self) -> list[Path]:
        """Return the paths of the photographs in the order of showing."""
        names = [name.replace(" ", "_") for name in self.pictures.names()]
        return [self.folder / f"{number:03d}_{name}.png" for number, name in enumerate(names)]


@dataclass(frozen=True, eq=False)
class CameraPose:
    """A camera at one pose, and the photographs taken from there.

    Attributes:
        lens, sensor: lens and sensor of the camera.
        frame_from_camera: (4, 4) pose of the camera, in the device frame if `optics` are given.
        optics: the optics in front of the camera; None without the headset.
        board: the target, flat and exact, or as printed.
        boards, panels: the photographs.
        seed: seed of the noise.
        eye: "left" or "right", so that the noise of the eyes is not mirrored.
        vibration_px: standard deviation of each photograph's motion blur, along a random direction.
        stray_light: fraction of the light spread over the picture.
    """

    lens: SimulatedLens
    sensor: Sensor
    frame_from_camera: FloatArray
    optics: EyeOptics | None
    board: Board | PrintedBoard
    boards: Sequence[BoardShot] = field(default_factory=tuple)
    panels: Sequence[PanelShots] = field(default_factory=tuple)
    seed: int = 1
    eye: str = "right"
    vibration_px: float = 0.0
    stray_light: float = 0.0

    def paths(self) -> list[Path]:
        """Return the paths of all photographs."""
        return [shot.path for shot in self.boards] + [path for shots in self.panels for path in shots.paths()]


def take(pose: CameraPose, missing: Sequence[Path] | None = None) -> list[Path]:
    """Take the missing photographs, by default all, and return their paths."""
    missing = pose.paths() if missing is None else missing
    if pose.optics is None:
        view = CameraView.without_headset(pose.lens, pose.frame_from_camera)
    else:
        view = CameraView.through_optics(pose.optics, pose.lens, pose.frame_from_camera)
    for shot in pose.boards:
        if shot.path in missing:
            light = view.world_light(BoardLight(pose.board, shot.frame_from_board))
            _photograph(pose, light, shot.path)
    for shots in pose.panels:
        dark = view.world_light(_DARK_ROOM)
        for number, path in enumerate(shots.paths()):
            if path in missing:
                light = view.panel_light(shots.pictures.image(number)) + dark
                _photograph(pose, light, path)
    return list(missing)


def _photograph(pose: CameraPose, light: Float32Array, path: Path) -> None:
    """Expose light (h, w) and write the photograph, with random numbers that do not depend on the order."""
    seed = [pose.seed, zlib.crc32("/".join(path.parts[-2:]).encode()), int(pose.eye == "left")]
    if pose.stray_light:
        light = light + np.float32(pose.stray_light) * veiling_glare(light)
    if pose.vibration_px:
        angle = np.random.default_rng([*seed, 1]).uniform(0.0, np.pi)
        light = blurred(light, pose.vibration_px * np.array([np.cos(angle), np.sin(angle)]))
    write_photograph(path, pose.sensor.expose(light, np.random.default_rng(seed)))


def veiling_glare(light: Float32Array) -> Float32Array:
    """Return light (h, w) blurred over a tenth of the picture, with darkness outside, computed on a small copy."""
    height, width = light.shape
    small = cv2.resize(light, (_SMALL_PX, _SMALL_PX), interpolation=cv2.INTER_AREA)
    blurred = cv2.GaussianBlur(small, (0, 0), _SPREAD * _SMALL_PX, borderType=cv2.BORDER_CONSTANT)
    return np.asarray(cv2.resize(blurred, (width, height), interpolation=cv2.INTER_LINEAR), dtype=np.float32)


def blurred(light: Float32Array, deviation_px: FloatArray) -> Float32Array:
    """Return light (h, w) blurred along a line, by a kernel with standard deviations (2,) in pixels."""
    steps = int(np.ceil(np.sum(deviation_px**2) / _WIDEST_STEP_PX2))
    (xx, xy), (_, yy) = np.outer(deviation_px, deviation_px) / steps
    second = 0.5 * np.array([[0.5 * xy, yy, -0.5 * xy], [xx, -2 * (xx + yy), xx], [-0.5 * xy, yy, 0.5 * xy]])
    kernel = second + [[0.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 0.0]]
    for _ in range(steps):
        light = np.asarray(cv2.filter2D(light, -1, kernel, borderType=cv2.BORDER_REPLICATE))
    return np.maximum(light, np.float32(0.0))
