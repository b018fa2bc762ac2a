"""Verify calibrations on the simulated bench of their session, as on a real one.

The target is drawn over itself and photographed with the display off and on. It is drawn by the fitted models, for the
camera position that the stage's reading gives and the target pose that the tracking camera sees. Photographs show the
true bench: each visit of the stage has its own random errors, and photographs are blurred, hazy and noisy as those of
the session. Nothing of the truth goes into the judgement. Several calibrations are compared on the same visits,
targets and photographs with the display off.
"""

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray

from wlr_render.atomic_files import output_folder
from wlr_render.calibration.bench.board_views import TRACKING, BoardView
from wlr_render.calibration.bench.start import board_pose
from wlr_render.calibration.bench.station_file import SavedStation, load_station
from wlr_render.captures.boards.board import BoardObservation
from wlr_render.compositing.raster_painter import WarpedPainter, traced_instead
from wlr_render.errors import BadInputError
from wlr_render.jobs import limits
from wlr_render.jobs.job import job
from wlr_render.jobs.options import (
    Backend,
    ProgressArgument,
    Range,
    Scheduler,
    Seed,
    SpreadOptions,
    Workers,
    described,
)
from wlr_render.jobs.verify.drawn_target import target_scene, wholly_shown
from wlr_render.jobs.verify.misalignment_tables import Judged, by_the_same_dots, judge_pair, misalignment_report
from wlr_render.jobs.verify.session_photographs import (
    Frames,
    TargetPlace,
    off_path,
    on_folder,
    photograph,
    photograph_tracking,
)
from wlr_render.mappings import Eye
from wlr_render.models.model_file import load_eye_model
from wlr_render.numerics.arrays import FloatArray
from wlr_render.progress import SILENT
from wlr_render.rendering.painters import Painter, TracedPainter
from wlr_render.rendering.ray_tracing import RayRenderer
from wlr_render.rendering.scene_raster import open_scene_raster
from wlr_render.report.blocks import Report
from wlr_render.simulation.photographs.photo_bench import PhotoBench, target_at
from wlr_render.simulation.photographs.photo_plan import Visit, later_visits
from wlr_render.simulation.photographs.recipe import load_recipe
from wlr_render.simulation.photographs.take_photographs import PanelShots
from wlr_render.simulation.viewpoints import random_in_eye_box

METHODS = ("raster + warp", "ray traced")
"""Without OpenGL the second alone."""
TargetPose = Literal["frontal", "tilted", "shifted"]
_FRONTAL: tuple[TargetPose, ...] = ("frontal",)
_ALL_POSES: tuple[TargetPose, ...] = ("frontal", "tilted", "shifted")
_SUPERSAMPLE = 3  # rays per display pixel and axis: the target's dots must not be jagged


@dataclass(frozen=True)
class VerifySessionOptions(SpreadOptions):
    """Options of `verify session`."""

    session: Annotated[Path, described("Folder of a simulated session, whose bench is used again.")]
    _: KW_ONLY
    calibration: Annotated[
        tuple[Path, ...],
        described(
            "Output folders of `calibrate photos`: of one calibration, or of several to compare, which may be of other "
            "sessions of the same bench.",
            many=True,
        ),
    ] = (Path("out/calibrate"),)
    viewpoints: Annotated[int, described("Number of camera positions in the eye box."), limits.PLACES] = 5
    depths_m: Annotated[tuple[float, ...], described("Distances of the target in m.", many=True), limits.DISTANCE_M] = (
        0.5,
        0.8,
    )
    poses: Annotated[
        tuple[TargetPose, ...],
        described(
            "Poses of the target at each distance: facing the eye, tilted, shifted (default: frontal for one "
            "calibration, all for several).",
            flag=True,
            many=True,
        ),
    ] = ()
    tilt_deg: Annotated[
        float,
        described("Angle by which the tilted target is rotated about the vertical, in degrees."),
        Range(at_least=-60, at_most=60),
    ] = 20.0
    shift_mm: Annotated[
        float,
        described("Displacement of the shifted target to the right in mm; half as much down."),
        Range(-1000, 1000),
    ] = 60.0
    seed: Seed = 1
    backend: Backend = "auto"
    workers: Workers = None
    scheduler: Scheduler = None
    out: Annotated[Path, described("Output folder.")] = Path("out/verify-session")

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check_product(limits.DEPTHS, "distances", "depths_m")
        self._check_product(10_000, "photographs", "viewpoints", "depths_m")


@dataclass(frozen=True, eq=False)
class _Calibration:
    """A calibration that is verified.

    Attributes:
        label: its name in tables; "" where it is the only one.
        prefix: of the names of what the panel shows.
        models: of the eye.
        station: of the bench.
    """

    label: str
    prefix: str
    models: Eye
    station: SavedStation

    def viewpoints(self, visits: Sequence[Visit]) -> FloatArray:
        """(n, 3) where the camera stands by its readings."""
        readings = [visit.reading for visit in visits]
        return np.stack([self.station.device_from_camera(each)[:3, 3] for each in readings if each is not None])


@job
def verify_session(options: VerifySessionOptions, *, progress: ProgressArgument = SILENT) -> Report:
    """Draw, photograph and match; writes photographs, pictures and the report into `options.out`.

    Raises:
        BadInputError: the session is not a simulated one, a calibration is missing or of another session, or the
            target is not seen where it stands.
    """
    bench = load_recipe(options.session).build()
    calibrations = _calibrations(options, bench)
    folder = output_folder(options.out)
    photographs = folder / "photographs"
    box = bench.optics.eye_box
    rng = np.random.default_rng([options.seed, 2])
    others = random_in_eye_box(box, options.viewpoints, rng)[1:] - box.centre
    visits = later_visits(bench, np.round(np.concatenate([np.zeros((1, 3)), others]), 6), rng)
    targets = _targets(bench, options)
    tracked = photograph_tracking(bench, targets, photographs, options.seed)
    found = [[_tracked_pose(each.station, bench, seen) for seen in tracked] for each in calibrations]
    viewpoints = [each.viewpoints(visits) for each in calibrations]
    frames: list[dict[str, NDArray[np.uint8]]] = [{} for _ in range(len(targets) * len(visits))]
    warnings: list[str] = []
    drawn = (
        images
        for each, poses, places in zip(calibrations, found, viewpoints, strict=True)
        for pose in poses
        for images in _draw(each, bench, pose, places, options, warnings)
    )
    for number, images in enumerate(progress(drawn, len(calibrations) * len(frames), "frames")):
        frames[number % len(frames)] |= images
    photograph(bench, visits, targets, frames, photographs, options.seed, progress, options.spread)
    methods = [method for method in METHODS if calibrations[0].prefix + method in frames[0]]
    judged = [
        one
        for k, target in enumerate(targets)
        for number in range(len(visits))
        for one in _judge(
            bench,
            calibrations,
            methods,
            target,
            number,
            [each[k] for each in found],
            [v[number] for v in viewpoints],
            photographs,
        )
    ]
    inputs = [options.session, *(each / "model.json" for each in options.calibration)]
    name = calibrations[0].models.name if len(calibrations) == 1 else f"{len(calibrations)} calibrations"
    return misalignment_report(judged, name, folder, inputs, options, list(dict.fromkeys(warnings)))


def _calibrations(options: VerifySessionOptions, bench: PhotoBench) -> list[_Calibration]:
    """Load the calibrations.

    Raises:
        BadInputError: one is missing, named twice, or of another session.
    """
    folders = options.calibration
    if not folders:
        raise BadInputError("--calibration is empty; name an output folder of `wlr-render calibrate photos`.")
    for number, folder in enumerate(folders):
        if folder in folders[:number]:
            raise BadInputError(f"--calibration names {folder} twice; name each calibration once.")
    several = len(folders) > 1
    # Folders of one name, e.g. a/out and b/out, are told apart by their paths.
    stems = [
        folder.name if [each.name for each in folders].count(folder.name) == 1 else str(folder) for folder in folders
    ]
    found = []
    for number, (folder, stem) in enumerate(zip(folders, stems, strict=True)):
        if not (folder / "model.json").is_file():
            raise BadInputError(
                f"{folder}: holds no model.json; run `wlr-render calibrate photos {options.session} --out "
                f"{folder}` first, or name its folder with --calibration."
            )
        model = load_eye_model(folder / "model.json", bench.eye)
        station = load_station(folder / f"station-{bench.eye}.json")
        _refuse_another(folder, options.session, (model.device, model.mappings.eye), station, bench)
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
            "`wlr-render calibrate photos` made of that session."
        )
    if station.tracking_camera is None or station.device_from_tracking is None:
        raise BadInputError(
            f"{folder}: the calibrated bench has no tracking camera, which says where the target stands; calibrate a "
            "session with [[tracking]] photographs."
        )


def _targets(bench: PhotoBench, options: VerifySessionOptions) -> list[TargetPlace]:
    poses = options.poses or (_FRONTAL if len(options.calibration) == 1 else _ALL_POSES)
    changes = {"frontal": (0.0, 0.0), "tilted": (options.tilt_deg, 0.0), "shifted": (0.0, 1e-3 * options.shift_mm)}
    return [
        TargetPlace(depth, "" if poses == _FRONTAL else pose, target_at(bench, depth, *changes[pose]))
        for depth in dict.fromkeys(options.depths_m)
        for pose in dict.fromkeys(poses)
    ]


def _tracked_pose(station: SavedStation, bench: PhotoBench, seen: BoardObservation) -> FloatArray:
    """device_from_target (4, 4) by the tracking camera of a calibrated bench."""
    assert station.tracking_camera is not None  # refused before
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
    options: VerifySessionOptions,
    warnings: list[str],
) -> Iterator[dict[str, NDArray[np.uint8]]]:
    """What the panel must show of a target at device_from_target (4, 4), from each viewpoint (n, 3), by each method.

    The target has the shape that calibration found. `warnings` receives a sentence if frames are ray traced for want of
    OpenGL.
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
    calibrations: Sequence[_Calibration],
    methods: Sequence[str],
    target: TargetPlace,
    viewpoint: int,
    poses: Sequence[FloatArray],
    places: Sequence[FloatArray],
    folder: Path,
) -> list[Judged]:
    """Match the dots of one place's photographs: those found in all that the panel can show whole by every calibration.

    `poses` (4, 4) of the target and `places` (3,) of the camera are by calibration.
    """
    shown = np.all(
        [
            wholly_shown(each.models, bench.board, pose, place)
            for each, pose, place in zip(calibrations, poses, places, strict=True)
        ],
        axis=0,
    )
    position, off = target.position(viewpoint), off_path(folder, target, viewpoint)
    names = tuple(each.prefix + method for each in calibrations for method in methods)
    paths = iter(PanelShots(on_folder(folder, target, viewpoint), Frames(names, ())).paths())
    return by_the_same_dots(
        [
            judge_pair(
                position, method, (off, next(paths)), bench.board, each.station.eyeball_camera, shown, each.label
            )
            for each in calibrations
            for method in methods
        ]
    )
