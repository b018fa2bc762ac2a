"""Registration of calibrations on the simulated bench of their session, measured as on a real bench.

The target is drawn over itself and photographed with the display off and on. The fitted models draw it, for the camera
position that the stage reads and the target pose that the tracking camera sees. Photographs show the true bench: each
visit of the stage has its own random errors, and blur, haze and noise are as in the session. The result does not use
the truth. All calibrations are compared on the same visits, targets, photographs with the display off, and dots.
"""

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.simulated_lab.drawn_target import target_scene, wholly_shown
from benchmarks.simulated_lab.lab_options import SimulatedLabOptions, TargetPose
from benchmarks.simulated_lab.later_places import later_visits, target_at
from benchmarks.simulated_lab.recipe_file import load_recipe
from benchmarks.simulated_lab.registration_photographs import (
    Frames,
    TargetPlace,
    off_path,
    on_folder,
    photograph,
    photograph_tracking,
)
from benchmarks.simulated_lab.saved_station import SavedStation, load_station
from wlr_render.calibration.bench.board_views import TRACKING, BoardView
from wlr_render.calibration.bench.start import board_pose
from wlr_render.captures.boards.board import BoardObservation
from wlr_render.draw.painters import Painter, TracedPainter
from wlr_render.draw.raster_painter import WarpedPainter, traced_instead
from wlr_render.draw.ray_tracing import RayRenderer
from wlr_render.draw.scene_raster import open_scene_raster
from wlr_render.errors import BadInputError
from wlr_render.evaluation.photograph_pair import JudgedPair, judge_pair
from wlr_render.jobs.verify import (
    NOTES,
    by_method,
    complaints,
    misalignment_pictures,
    misalignment_table,
    table_of_pairs,
    verdict,
)
from wlr_render.mappings import Eye
from wlr_render.models.model_file import load_eye_model
from wlr_render.numerics.arrays import FloatArray
from wlr_render.report.blocks import Block, Plot, ReportTable
from wlr_render.report.plots import curves
from wlr_render.simulation.photographs.photo_bench import PhotoBench
from wlr_render.simulation.photographs.photo_plan import Visit
from wlr_render.simulation.photographs.take_photographs import PanelShots
from wlr_render.simulation.viewpoints import random_in_eye_box
from wlr_render.work.progress import Progress

METHODS = ("raster + warp", "ray traced")
"""Methods; without OpenGL only the second."""
_FRONTAL: tuple[TargetPose, ...] = ("frontal",)
_ALL_POSES: tuple[TargetPose, ...] = ("frontal", "tilted", "shifted")
_TILT_DEG, _SHIFT_M = 20.0, 0.06  # rotation about the vertical; shift to the right, and half as much down
_SUPERSAMPLE = 3  # rays per display pixel and axis, so that the target's dots are not jagged


@dataclass(frozen=True, eq=False)
class Registration:
    """The judged pairs of photographs.

    Attributes:
        judged: by target, viewpoint, calibration and method; methods of several calibrations begin with their names.
        of_target: target of each pair, by the pair's name.
        drawn: the pairs to draw.
        warnings: frames that are not rasterised, photographs that show too little.
    """

    judged: list[JudgedPair]
    of_target: dict[str, str]
    drawn: list[JudgedPair]
    warnings: list[str]

    @property
    def verdict(self) -> str:
        """A sentence for each method."""
        return verdict(self.judged)

    def blocks(self, folder: Path) -> list[Block]:
        """Return tables over all pairs, by target if there are several, and of each pair; draw into `folder`."""
        by_target = []
        if len(set(self.of_target.values())) > 1:
            heads = {"target": lambda pair: self.of_target[pair.name], "method": by_method}
            by_target = [misalignment_table(self.judged, "By target", heads)]
        pictures = misalignment_pictures(self.drawn, folder)
        return [self._overall(), *by_target, table_of_pairs(self.judged), self._distribution(), *pictures]

    def _overall(self) -> ReportTable:
        notes = (*NOTES, "The dots that all methods show whole, found in all photographs of a position.")
        return misalignment_table(self.judged, "Misalignment from photographs", {"method": by_method}, notes)

    def _distribution(self) -> Plot:
        percent = np.linspace(0, 100, 201)
        lines = {}
        for method in dict.fromkeys(pair.method for pair in self.judged):
            pairs = [pair.misalignment for pair in self.judged if pair.method == method]
            angle = np.concatenate([each.arcmin for each in pairs if each is not None] or [np.empty(0)])
            if len(angle):
                lines[method] = np.percentile(angle, percent), percent
        axes = ("misalignment (arcmin)", "dots with less (%)")
        return curves("Distribution of misalignment", lines, axes, log_x=True, caption="All targets and viewpoints.")


@dataclass(frozen=True, eq=False)
class _Calibration:
    """A calibration that is verified.

    Attributes:
        label: name of the calibration in tables; "" for a single calibration.
        prefix: prefix of the names of panel pictures.
        models: models of the eye.
        station: station of the bench.
    """

    label: str
    prefix: str
    models: Eye
    station: SavedStation

    def viewpoints(self, visits: Sequence[Visit]) -> FloatArray:
        """Return the positions (n, 3) of the camera by its readings."""
        return np.stack([self.station.device_from_camera(visit.reading)[:3, 3] for visit in visits])


def register(options: SimulatedLabOptions, folder: Path, progress: Progress) -> Registration:
    """Draw, photograph and match; write the photographs into `photographs` in `folder`.

    Raises:
        BadInputError: the session is not simulated, a calibration is missing or of another session, or the target is
            not seen at a position.
    """
    bench, photographs = load_recipe(options.simulated_session).build(), folder / "photographs"
    calibrations = _calibrations(options, bench)
    box = bench.optics.eye_box
    rng = np.random.default_rng([options.seed, 2])
    others = random_in_eye_box(box, options.viewpoints, rng)[1:] - box.centre
    visits = later_visits(bench, np.round(np.concatenate([np.zeros((1, 3)), others]), 6), rng)
    targets = _targets(bench, options)
    tracked = photograph_tracking(bench, targets, photographs, options.seed)
    poses = [[_tracked_pose(each.station, bench, view) for view in tracked] for each in calibrations]
    viewpoints = [each.viewpoints(visits) for each in calibrations]
    frames: list[dict[str, NDArray[np.uint8]]] = [{} for _ in range(len(targets) * len(visits))]
    warnings: list[str] = []
    drawn = (
        images
        for each, poses_of_target, places in zip(calibrations, poses, viewpoints, strict=True)
        for pose in poses_of_target
        for images in _draw(each, bench, pose, places, options, warnings)
    )
    for number, images in enumerate(progress(drawn, len(calibrations) * len(frames), "frames")):
        frames[number % len(frames)] |= images
    photograph(bench, visits, targets, frames, photographs, options.seed, progress, options.worker_pool)
    methods = [method for method in METHODS if calibrations[0].prefix + method in frames[0]]
    found = Registration([], {}, [], list(dict.fromkeys(warnings)))
    for k, target in enumerate(targets):
        for number in range(len(visits)):
            placed = [
                (each, of_target[k], places[number])
                for each, of_target, places in zip(calibrations, poses, viewpoints, strict=True)
            ]
            pairs = _judge(bench, placed, methods, target, number, photographs)
            found.judged.extend(pairs)
            found.of_target[target.position(number)] = target.words
            found.drawn.extend(pairs if len(calibrations) == 1 or number == 0 else [])
    found.warnings.extend(complaints(found.judged))
    return found


def _calibrations(options: SimulatedLabOptions, bench: PhotoBench) -> list[_Calibration]:
    """Load the calibrations.

    Raises:
        BadInputError: a calibration is missing, named twice, or of another session.
    """
    folders = options.calibration
    for number, folder in enumerate(folders):
        if folder in folders[:number]:
            raise BadInputError(f"--calibration names {folder} twice; name each calibration once.")
    several = len(folders) > 1
    # Paths distinguish folders with the same name, e.g. a/out and b/out.
    stems = [
        folder.name if [each.name for each in folders].count(folder.name) == 1 else str(folder) for folder in folders
    ]
    found = []
    for number, (folder, stem) in enumerate(zip(folders, stems, strict=True)):
        if not (folder / "model.json").is_file():
            raise BadInputError(
                f"{folder}: holds no model.json; run `wlr-render calibrate {options.simulated_session} --out "
                f"{folder}` first, or name its folder with --calibration."
            )
        model = load_eye_model(folder / "model.json", bench.eye)
        station = load_station(folder / f"station-{bench.eye}.json")
        _refuse_another(folder, options.simulated_session, (model.device, model.mappings.eye), station, bench)
        prefix = f"model{number} " if several else ""
        found.append(_Calibration(stem if several else "", prefix, model.mappings, station))
    return found


def _refuse_another(
    folder: Path, session: Path, calibrated: tuple[str, str], station: SavedStation, bench: PhotoBench
) -> None:
    size = station.eyeball_camera.size_px
    if calibrated != (bench.device.name, bench.eye) or size != bench.eyeball.camera.size_px:
        raise BadInputError(
            f"{folder}: is a calibration of {calibrated[0]}, {calibrated[1]} eye, with a camera of "
            f"{size[0]} x {size[1]} pixels, and not of {session}; name the folder of what "
            "`wlr-render calibrate` made of that session."
        )
    if station.tracking_camera is None or station.device_from_tracking is None:
        raise BadInputError(
            f"{folder}: the calibrated bench has no tracking camera, which says where the target stands; calibrate a "
            "session with [[tracking]] photographs."
        )


def _targets(bench: PhotoBench, options: SimulatedLabOptions) -> list[TargetPlace]:
    poses = options.poses or (_FRONTAL if len(options.calibration) == 1 else _ALL_POSES)
    changes = {"frontal": (0.0, 0.0), "tilted": (_TILT_DEG, 0.0), "shifted": (0.0, _SHIFT_M)}
    return [
        TargetPlace(depth, "" if poses == _FRONTAL else pose, target_at(bench, depth, *changes[pose]))
        for depth in dict.fromkeys(options.depths_m)
        for pose in dict.fromkeys(poses)
    ]


def _tracked_pose(station: SavedStation, bench: PhotoBench, seen: BoardObservation) -> FloatArray:
    """Return device_from_target (4, 4) by the tracking camera of a calibrated bench."""
    assert station.tracking_camera is not None  # a missing tracking camera was refused before
    assert station.device_from_tracking is not None
    point = bench.board.point_of(seen.index)
    if station.shape is not None:
        point = station.shape.point_of(seen.index, point)
    view = BoardView("tracking", TRACKING, seen.index, point, seen.pixel, seen.sigma_px, discs=seen.discs)
    lens = station.tracking_camera
    return np.asarray(station.device_from_tracking @ board_pose(lens, view.seen_by(lens))[0])


def _draw(
    calibration: _Calibration,
    bench: PhotoBench,
    target: FloatArray,
    viewpoints: FloatArray,
    options: SimulatedLabOptions,
    warnings: list[str],
) -> Iterator[dict[str, NDArray[np.uint8]]]:
    """Yield the panel pictures of a target at device_from_target (4, 4) by each method, per viewpoint (n, 3).

    The target has the shape of the calibration. `warnings` receives a sentence if frames are ray traced because OpenGL
    is missing.
    """
    scene, models = target_scene(bench.board, calibration.station.shape, target), calibration.models
    raster, renderer = open_scene_raster(scene, options.backend), RayRenderer(scene)
    warnings += traced_instead(raster, options.backend)
    painters: dict[str, Painter] = {"ray traced": TracedPainter(models, renderer, _SUPERSAMPLE)}
    if raster is not None:
        painters["raster + warp"] = WarpedPainter(models, raster, 2.0)
    with raster.context if raster else contextlib.nullcontext():
        for viewpoint in viewpoints:
            yield {
                calibration.prefix + method: painters[method].paint(viewpoint, np.eye(4)).colour[..., 1]
                for method in METHODS
                if method in painters
            }


def _judge(
    bench: PhotoBench,
    placed: Sequence[tuple[_Calibration, FloatArray, FloatArray]],
    methods: Sequence[str],
    target: TargetPlace,
    viewpoint: int,
    folder: Path,
) -> list[JudgedPair]:
    """Match the dots of one position that are found in all photographs and shown whole by every calibration.

    `placed` has each calibration with its pose (4, 4) of the target and position (3,) of the camera.
    """
    whole = np.all([wholly_shown(each.models, bench.board, pose, place) for each, pose, place in placed], axis=0)
    names = tuple(each.prefix + method for each, *_ in placed for method in methods)
    paths = iter(PanelShots(on_folder(folder, target, viewpoint), Frames(names, ())).paths())
    position, off = target.position(viewpoint), off_path(folder, target, viewpoint)
    pairs = [
        judge_pair(
            position,
            f"{each.label}, {method}" if each.label else method,
            (off, next(paths)),
            bench.board,
            each.station.eyeball_camera,
        )
        for each, *_ in placed
        for method in methods
    ]
    matched = [{*map(tuple, each.misalignment.index.tolist())} for each in pairs if each.misalignment is not None]
    common = {(int(column), int(row)) for row, column in np.argwhere(whole)}.intersection(*matched)
    return [replace(each, misalignment=each.misalignment and each.misalignment.only(common)) for each in pairs]
