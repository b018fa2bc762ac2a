"""Photographs of a registration on a simulated bench: the target alone, by both cameras, and with the display on."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wlr_render.captures.boards.board import BoardObservation
from wlr_render.captures.photographs import read_photograph
from wlr_render.numerics.arrays import FloatArray
from wlr_render.simulation.photographs.photo_bench import PhotoBench
from wlr_render.simulation.photographs.photo_plan import Visit
from wlr_render.simulation.photographs.simulate_photo_session import poses_on
from wlr_render.simulation.photographs.take_photographs import BoardShot, PanelShots, take
from wlr_render.work.progress import Progress
from wlr_render.work.workers import WorkerPool, as_finished


@dataclass(frozen=True, eq=False)
class TargetPlace:
    """A position and orientation of the target.

    Attributes:
        depth_m: distance of the target.
        pose: orientation in words; "" if all targets are frontal.
        device_from_target: (4, 4) true pose.
    """

    depth_m: float
    pose: str
    device_from_target: FloatArray

    @property
    def stem(self) -> str:
        """Part of the names of photographs."""
        return f"{1e3 * self.depth_m:.0f}mm" + (f"_{self.pose}" if self.pose else "")

    @property
    def words(self) -> str:
        """Text with distance and orientation, for tables."""
        return f"{self.depth_m:g} m" + (f", {self.pose}" if self.pose else "")

    def position(self, viewpoint: int) -> str:
        """Return the name of the photographs from a viewpoint."""
        return f"{self.words}, viewpoint {viewpoint}"


@dataclass(frozen=True, eq=False)
class Frames:
    """Panel pictures, in the form of `take_photographs.Pictures`."""

    shown: tuple[str, ...]
    images: tuple[NDArray[np.uint8], ...]

    def names(self) -> tuple[str, ...]:
        """Return the names of the pictures in the order in which they are shown."""
        return self.shown

    def image(self, index: int) -> NDArray[np.uint8]:
        """Return the picture with number `index`."""
        return self.images[index]


def photograph_tracking(
    bench: PhotoBench, targets: Sequence[TargetPlace], folder: Path, seed: int
) -> list[BoardObservation]:
    """Photograph the target at each position with the tracking camera; BadInputError if it is not seen."""
    shots = tuple(BoardShot(folder / f"tracking_{each.stem}.png", each.device_from_target) for each in targets)
    pose = poses_on(bench, seed)
    take(pose(bench.tracking, bench.tracking_sensor, bench.device_from_tracking, None, boards=shots))
    return [bench.board.find(read_photograph(shot.path), shot.path.name) for shot in shots]


def photograph(
    bench: PhotoBench,
    visits: Sequence[Visit],
    targets: Sequence[TargetPlace],
    frames: Sequence[dict[str, NDArray[np.uint8]]],
    folder: Path,
    seed: int,
    progress: Progress,
    workers: WorkerPool,
) -> None:
    """Take the photographs of each visit with the display off, and with each of its frames, by target and visit."""
    pose, places = poses_on(bench, seed), []
    for number, visit in enumerate(visits):
        boards = [BoardShot(off_path(folder, target, number), target.device_from_target) for target in targets]
        panels = []
        for k, target in enumerate(targets):
            drawn = frames[len(visits) * k + number]
            panels.append(PanelShots(on_folder(folder, target, number), Frames(tuple(drawn), tuple(drawn.values()))))
        camera = visit.device_from_camera
        places.append(pose(bench.eyeball, bench.eyeball_sensor, camera, bench.optics, boards=boards, panels=panels))
    for _ in progress(as_finished(take, places, workers, folder), len(places), "viewpoints"):
        pass


def off_path(folder: Path, target: TargetPlace, viewpoint: int) -> Path:
    """Return the path of the photograph with the display off."""
    return folder / f"{target.stem}_view{viewpoint:02d}_off.png"


def on_folder(folder: Path, target: TargetPlace, viewpoint: int) -> Path:
    """Return the folder of the photographs with the display on."""
    return folder / f"{target.stem}_view{viewpoint:02d}_on"
