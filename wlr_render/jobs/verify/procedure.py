"""Draw the target where it was seen to stand, photograph it with the display off and on, and say how far they differ.

What is drawn is drawn by fitted models, for the place of the camera that its stage reports and the pose of the target
that the tracking camera sees; what is photographed is the truth. Nothing of the truth goes into the judgement.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wlr_render.calibration.board_poses import BoardView, poses_of
from wlr_render.calibration.station_file import SavedStation
from wlr_render.captures.photographs import read_photograph
from wlr_render.captures.targets.find_board import find_board
from wlr_render.errors import BadInputError
from wlr_render.geometry.lens_camera import LensCamera
from wlr_render.jobs.processes import as_finished
from wlr_render.jobs.simulate.shots import BoardShot, PanelShots, Place, take
from wlr_render.jobs.verify import judgement
from wlr_render.jobs.verify.judgement import Judged
from wlr_render.jobs.verify.target_scene import target_scene
from wlr_render.mappings import EyeMappings
from wlr_render.numerics.arrays import FloatArray
from wlr_render.progress import Progress
from wlr_render.rendering.painters import Painter, TracedPainter, WarpedPainter
from wlr_render.rendering.raster_backends import open_raster_backend
from wlr_render.rendering.ray_tracing import RayRenderer
from wlr_render.simulation.photographs.photo_bench import PhotoBench, target_at

METHODS = ("raster + warp", "ray traced")
_SUPERSAMPLE = 3  # rays per display pixel and axis: the target's dots must not be jagged


@dataclass(frozen=True, eq=False)
class _Frames:
    """What the panel shows, as `shots.Pictures`."""

    shown: tuple[str, ...]
    images: tuple[NDArray[np.uint8], ...]

    def names(self) -> tuple[str, ...]:
        return self.shown

    def image(self, index: int) -> NDArray[np.uint8]:
        return self.images[index]


def track_targets(
    bench: PhotoBench, station: SavedStation, depths_m: Sequence[float], folder: Path
) -> list[FloatArray]:
    """Where the tracking camera sees the target at each distance: device_from_target (4, 4) each.

    Raises:
        BadInputError: it does not see it.
    """
    shots = tuple(BoardShot(folder / f"tracking_{_name(depth)}.png", target_at(bench, depth)) for depth in depths_m)
    _retake(Place(bench.tracking, bench.tracking_sensor, bench.device_from_tracking, None, bench.board, shots))
    poses = []
    for shot in shots:
        observation = find_board(read_photograph(shot.path), bench.board, shot.path.name)
        seen = poses_of(station.tracking_camera, [BoardView.of_observation(shot.path.name, observation, bench.board)])
        if not len(seen):
            raise BadInputError(f"{shot.path}: {seen.rejected[shot.path.name]}")
        poses.append(station.device_from_tracking @ seen.camera_from_board[0])
    return poses


def draw(
    models: EyeMappings, bench: PhotoBench, target: FloatArray, viewpoints: FloatArray, backend: str
) -> Iterator[dict[str, NDArray[np.uint8]]]:
    """What the panel must show of a target at device_from_target (4, 4), from each viewpoint (n, 3), by each method."""
    scene = target_scene(bench.board, target)
    painters: dict[str, Painter] = {
        METHODS[0]: WarpedPainter(models, open_raster_backend(scene, backend), 2.0),
        METHODS[1]: TracedPainter(models, RayRenderer(scene), _SUPERSAMPLE),
    }
    for viewpoint in viewpoints:
        yield {method: painter.paint(viewpoint, np.eye(4)).colour[..., 1] for method, painter in painters.items()}


def photograph(
    bench: PhotoBench,
    stage: FloatArray,
    depths_m: Sequence[float],
    frames: Sequence[Sequence[dict[str, NDArray[np.uint8]]]],
    folder: Path,
    seed: int,
    progress: Progress,
    workers: int | None,
) -> None:
    """Take the photographs at stage readings (n, 3), with the display off and showing `frames[depth][viewpoint]`."""
    places = []
    for number, reading in enumerate(stage):
        boards = [BoardShot(off_path(folder, depth, number), target_at(bench, depth)) for depth in depths_m]
        panels = [
            PanelShots(
                on_folder(folder, depth, number), _Frames(METHODS, tuple(drawn[number][method] for method in METHODS))
            )
            for depth, drawn in zip(depths_m, frames, strict=True)
        ]
        places.append(
            Place(
                bench.eyeball,
                bench.eyeball_sensor,
                bench.camera_at(reading),
                bench.optics,
                bench.board,
                boards,
                panels,
                seed,
            )
        )
    for _ in progress(as_finished(_retake, places, workers), len(places), "viewpoints"):
        pass


def _retake(place: Place) -> int:
    """Take all photographs, also those that are there: they may be of other models."""
    for path in place.paths():
        path.unlink(missing_ok=True)
    return take(place)


def judge(
    bench: PhotoBench, camera: LensCamera, depth_m: float, viewpoint: int, shown: NDArray[np.bool_], folder: Path
) -> Iterator[Judged]:
    """Match the dots of one place's photographs, of those that the panel can show whole: `shown` (rows, columns)."""
    place = judgement.Place(f"{depth_m:g} m, viewpoint {viewpoint}", depth_m, viewpoint)
    off = off_path(folder, depth_m, viewpoint)
    shots = PanelShots(on_folder(folder, depth_m, viewpoint), _Frames(METHODS, ()))
    for method, on in zip(METHODS, shots.paths(), strict=True):
        yield judgement.judge_pair(place, method, (off, on), bench.board, camera, shown)


def off_path(folder: Path, depth_m: float, viewpoint: int) -> Path:
    """Of the photograph with the display off."""
    return folder / f"{_name(depth_m)}_view{viewpoint:02d}_off.png"


def on_folder(folder: Path, depth_m: float, viewpoint: int) -> Path:
    """Of the photographs with the display on, one a method."""
    return folder / f"{_name(depth_m)}_view{viewpoint:02d}_on"


def _name(depth_m: float) -> str:
    return f"{1e3 * depth_m:.0f}mm"
