"""Verify a calibration on the simulated bench of its session, as on a real one.

The target is drawn over itself and photographed with the display off and on. It is drawn by the fitted models, for the
camera position that the stage's reading gives and the target pose that the tracking camera sees. Photographs show the
true bench: each visit of the stage has its own random errors, and photographs are blurred, hazy and noisy as those of
the session. Nothing of the truth goes into the judgement.
"""

from collections.abc import Iterator, Sequence
from dataclasses import KW_ONLY, dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from wlr_render.calibration.bench.bench_file import SavedStation, load_station
from wlr_render.calibration.bench.observations import TRACKING, BoardView
from wlr_render.calibration.bench.start import board_pose
from wlr_render.calibration.bench.state import BoardShape
from wlr_render.captures.boards.dot_board import DotBoard
from wlr_render.captures.photographs import read_photograph
from wlr_render.errors import BadInputError
from wlr_render.files import output_folder
from wlr_render.geometry import transforms
from wlr_render.geometry.lens import Lens
from wlr_render.jobs.options import (
    Backend,
    MapFrom,
    Options,
    ProgressArgument,
    Range,
    RasterCamera,
    Seed,
    Workers,
    described,
)
from wlr_render.jobs.verify.misalignment import Judged, PairPosition, judge_pair, misalignment_report
from wlr_render.mappings import EyeMappings
from wlr_render.models.model_file import load_eye_model
from wlr_render.numerics.arrays import FloatArray
from wlr_render.processes import as_finished
from wlr_render.progress import SILENT, Progress
from wlr_render.rendering.painters import Painter, TracedPainter, raster_painter
from wlr_render.rendering.raster_backends import open_raster_backend
from wlr_render.rendering.ray_tracing import RayRenderer
from wlr_render.rendering.scene import Instance, Mesh, Scene
from wlr_render.rendering.shapes import construction
from wlr_render.rendering.srgb import encode_srgb
from wlr_render.report.blocks import Report
from wlr_render.simulation.photographs.photo_bench import PhotoBench, target_at
from wlr_render.simulation.photographs.photo_plan import Visit, later_visits
from wlr_render.simulation.photographs.recipe import load_recipe
from wlr_render.simulation.photographs.simulate_photo_session import poses_on
from wlr_render.simulation.photographs.take_photographs import BoardShot, CameraPose, PanelShots, take
from wlr_render.simulation.viewpoints import random_in_eye_box

METHODS = ("raster + warp", "ray traced")
_SUPERSAMPLE = 3  # rays per display pixel and axis: the target's dots must not be jagged
_TEXELS_PER_PITCH = 64
_LARGEST_TEXTURE_PX = 8192
_AROUND = 1.3  # of a dot's radius: some white has to be seen around it
_RING = 12
_EDGE_PX = 2.0  # panel pixels


@dataclass(frozen=True)
class VerifySessionOptions(Options):
    """Options of `verify session`."""

    session: Annotated[Path, described("Folder of a simulated session, whose bench is used again.")]
    _: KW_ONLY
    calibration: Annotated[Path, described("Output folder of `calibrate photos`.")] = Path("out/calibrate")
    viewpoints: Annotated[int, described("Number of camera positions in the eye box."), Range(at_least=1)] = 5
    depths_m: Annotated[tuple[float, ...], described("Distances of the target in m.", many=True), Range(at_least=0)] = (
        0.5,
        0.8,
    )
    seed: Seed = 1
    raster_camera: RasterCamera = "nearest"
    map_from: MapFrom = "depth"
    backend: Backend = "auto"
    workers: Workers = None
    out: Annotated[Path, described("Output folder.")] = Path("out/verify")


def verify_session(options: VerifySessionOptions, *, progress: ProgressArgument = SILENT) -> Report:
    """Draw, photograph and match; writes photographs, pictures and the report into `options.out`.

    Raises:
        BadInputError: the session is not a simulated one, the calibration is missing or of another session, or the
            target is not seen where it stands.
    """
    bench = load_recipe(options.session).build()
    if not (options.calibration / "model.json").is_file():
        raise BadInputError(
            f"{options.calibration}: holds no model.json; run `wlr-render calibrate photos {options.session} --out "
            f"{options.calibration}` first, or name its folder with --calibration."
        )
    model = load_eye_model(options.calibration / "model.json", bench.eye)
    models, station = model.mappings, load_station(options.calibration / f"station-{bench.eye}.json")
    _refuse_another(options, (model.device, models.eye), station.eyeball_camera, bench)
    folder = output_folder(options.out)
    photographs = folder / "photographs"
    box = bench.optics.eye_box
    rng = np.random.default_rng([options.seed, 2])
    others = random_in_eye_box(box, options.viewpoints, rng)[1:] - box.centre
    visits = later_visits(bench, np.round(np.concatenate([np.zeros((1, 3)), others]), 6), rng)
    viewpoints = np.stack([_camera_of(station, visit)[:3, 3] for visit in visits])
    targets = _track_targets(bench, station, options.depths_m, photographs, options.seed)
    total = len(targets) * len(visits)
    drawn = progress(
        (frames for pose in targets for frames in _draw(models, bench, station.shape, pose, viewpoints, options)),
        total,
        "frames",
    )
    flat = list(drawn)
    frames = [flat[len(visits) * k : len(visits) * (k + 1)] for k in range(len(targets))]
    _photograph(bench, visits, options.depths_m, frames, photographs, options.seed, progress, options.workers)
    judged = [
        one
        for depth, target in zip(options.depths_m, targets, strict=True)
        for number, viewpoint in enumerate(viewpoints)
        for one in _judge(
            bench,
            station.eyeball_camera,
            depth,
            number,
            wholly_shown(models, bench.board, target, viewpoint),
            photographs,
        )
    ]
    inputs = [options.session, options.calibration / "model.json"]
    return misalignment_report(judged, models.name, folder, inputs, options)


def _refuse_another(
    options: VerifySessionOptions, calibrated: tuple[str, str], camera: Lens, bench: PhotoBench
) -> None:
    if calibrated != (bench.device.name, bench.eye) or camera.size_px != bench.eyeball.camera.size_px:
        raise BadInputError(
            f"{options.calibration}: is a calibration of {calibrated[0]}, {calibrated[1]} eye, with a camera of "
            f"{camera.size_px[0]} x {camera.size_px[1]} pixels, and not of {options.session}; name the folder of what "
            "`wlr-render calibrate photos` made of that session."
        )


@dataclass(frozen=True, eq=False)
class _Frames:
    """What the panel shows, as `take_photographs.Pictures`."""

    shown: tuple[str, ...]
    images: tuple[NDArray[np.uint8], ...]

    def names(self) -> tuple[str, ...]:
        return self.shown

    def image(self, index: int) -> NDArray[np.uint8]:
        return self.images[index]


def _camera_of(station: SavedStation, visit: Visit) -> FloatArray:
    assert visit.reading is not None  # of a bench with a stage, which alone is rendered
    return station.device_from_camera(visit.reading)


def _track_targets(
    bench: PhotoBench, station: SavedStation, depths_m: Sequence[float], folder: Path, seed: int
) -> list[FloatArray]:
    """Where the tracking camera sees the target at each distance: device_from_target (4, 4) each.

    Raises:
        BadInputError: it does not see it.
    """
    if station.tracking_camera is None or station.device_from_tracking is None:
        raise BadInputError("the calibrated bench has no tracking camera, which says where the target stands.")
    shots = tuple(BoardShot(folder / f"tracking_{_name(depth)}.png", target_at(bench, depth)) for depth in depths_m)
    pose = poses_on(bench, seed)
    _retake(pose(bench.tracking, bench.tracking_sensor, bench.device_from_tracking, None, boards=shots))
    poses = []
    for shot in shots:
        observation = bench.board.find(read_photograph(shot.path), shot.path.name)
        point = bench.board.point_of(observation.index)
        if station.shape is not None:
            point = station.shape.point_of(observation.index, point)
        view = BoardView(shot.path.name, TRACKING, observation.index, point, observation.pixel, observation.sigma_px)
        poses.append(station.device_from_tracking @ board_pose(station.tracking_camera, view)[0])
    return poses


def _draw(
    models: EyeMappings,
    bench: PhotoBench,
    shape: BoardShape | None,
    target: FloatArray,
    viewpoints: FloatArray,
    options: VerifySessionOptions,
) -> Iterator[dict[str, NDArray[np.uint8]]]:
    """What the panel must show of a target at device_from_target (4, 4), from each viewpoint (n, 3), by each method.

    The target has the shape that calibration found.
    """
    scene = target_scene(bench.board, shape, target)
    raster_backend, renderer = open_raster_backend(scene, options.backend), RayRenderer(scene)
    mesh = renderer if options.map_from == "mesh" else None
    painters: dict[str, Painter] = {
        METHODS[0]: raster_painter(models, raster_backend, mesh, 2.0, options.raster_camera),
        METHODS[1]: TracedPainter(models, renderer, _SUPERSAMPLE),
    }
    for viewpoint in viewpoints:
        yield {method: painter.paint(viewpoint, np.eye(4)).colour[..., 1] for method, painter in painters.items()}


def _photograph(
    bench: PhotoBench,
    visits: Sequence[Visit],
    depths_m: Sequence[float],
    frames: Sequence[Sequence[dict[str, NDArray[np.uint8]]]],
    folder: Path,
    seed: int,
    progress: Progress,
    workers: int | None,
) -> None:
    """Take the photographs of each visit, with the display off and showing `frames[depth][viewpoint]`."""
    pose, places = poses_on(bench, seed), []
    for number, visit in enumerate(visits):
        boards = [BoardShot(_off_path(folder, depth, number), target_at(bench, depth)) for depth in depths_m]
        panels = [
            PanelShots(
                _on_folder(folder, depth, number), _Frames(METHODS, tuple(drawn[number][method] for method in METHODS))
            )
            for depth, drawn in zip(depths_m, frames, strict=True)
        ]
        places.append(
            pose(
                bench.eyeball,
                bench.eyeball_sensor,
                visit.device_from_camera,
                bench.optics,
                boards=boards,
                panels=panels,
            )
        )
    for _ in progress(as_finished(_retake, places, workers), len(places), "viewpoints"):
        pass


def _retake(pose: CameraPose) -> int:
    """Take all photographs, also those that are there: they may be of other models."""
    for path in pose.paths():
        path.unlink(missing_ok=True)
    return take(pose)


def _judge(
    bench: PhotoBench, camera: Lens, depth_m: float, viewpoint: int, shown: NDArray[np.bool_], folder: Path
) -> Iterator[Judged]:
    """Match the dots of one place's photographs, of those that the panel can show whole: `shown` (rows, columns)."""
    place = PairPosition(f"{depth_m:g} m, viewpoint {viewpoint}", depth_m, viewpoint)
    off = _off_path(folder, depth_m, viewpoint)
    shots = PanelShots(_on_folder(folder, depth_m, viewpoint), _Frames(METHODS, ()))
    for method, on in zip(METHODS, shots.paths(), strict=True):
        yield judge_pair(place, method, (off, on), bench.board, camera, shown)


def _off_path(folder: Path, depth_m: float, viewpoint: int) -> Path:
    """Of the photograph with the display off."""
    return folder / f"{_name(depth_m)}_view{viewpoint:02d}_off.png"


def _on_folder(folder: Path, depth_m: float, viewpoint: int) -> Path:
    """Of the photographs with the display on, one a method."""
    return folder / f"{_name(depth_m)}_view{viewpoint:02d}_on"


def _name(depth_m: float) -> str:
    return f"{1e3 * depth_m:.0f}mm"


def target_scene(board: DotBoard, shape: BoardShape | None, world_from_target: FloatArray) -> Scene:
    """Return the board alone in the dark, evenly bright.

    Args:
        board: the target.
        shape: its true shape as calibration found it; None for a flat and exact board.
        world_from_target: (4, 4) its pose.
    """
    mesh_from_target = transforms.rigid(transforms.OPENXR_FROM_OPENCV, np.zeros(3))
    world_from_mesh = world_from_target @ transforms.inverse(mesh_from_target)
    ambient = np.ones(3, np.float32)
    return Scene("target", (_mesh(board, shape),), (Instance("target", 0, world_from_mesh),), (), ambient)


def _mesh(board: DotBoard, shape: BoardShape | None) -> Mesh:
    """The board upright as seen from the front: x right, y up, facing +z. Vertices are dots' centres and the edge."""
    width, height = board.size_m
    texel = max(board.pitch_m / _TEXELS_PER_PITCH, float(max(width, height)) / _LARGEST_TEXTURE_PX)
    columns, rows = (int(np.ceil(length / texel)) for length in (width, height))
    x = (np.arange(columns) + 0.5) / columns * width - 0.5 * width
    y = (np.arange(rows) + 0.5) / rows * height - 0.5 * height
    paint = board.reflectance(np.stack(np.meshgrid(x, y), axis=-1), texel)
    texture = encode_srgb(np.repeat(paint[..., None], 3, axis=-1).astype(np.float32))
    column, row = (np.clip(np.arange(-1, count + 1), 0, count - 1) for count in (board.columns, board.rows))
    index = np.stack(np.meshgrid(column, row), axis=-1)
    nominal = board.point_of(index)
    nominal[:, [0, -1], 0] = 0.5 * width * np.array([-1.0, 1.0])
    nominal[[0, -1], :, 1] = 0.5 * height * np.array([[-1.0], [1.0]])
    point = nominal
    if shape is not None:
        point = shape.point_of(index.reshape(-1, 2), nominal.reshape(-1, 3)).reshape(nominal.shape)
    position = point @ transforms.OPENXR_FROM_OPENCV.T
    mesh = construction.from_grid("target", position, np.broadcast_to([0.0, 0.0, 1.0], position.shape))
    uv = nominal[..., :2] / board.size_m + 0.5
    return replace(mesh, uv=uv.reshape(-1, 2).astype(np.float32), texture=texture)


def wholly_shown(
    models: EyeMappings, board: DotBoard, device_from_target: FloatArray, viewpoint: FloatArray
) -> NDArray[np.bool_]:
    """(rows, columns) which dots lie on the panel with their surroundings: the panel's edge displaces the others.

    Args:
        models: of the eye.
        board: the target.
        device_from_target: (4, 4) where it is drawn.
        viewpoint: (3,) for which it is drawn.
    """
    index = board.indices()
    angle = np.linspace(0.0, 2.0 * np.pi, _RING, endpoint=False)
    ring = np.stack([np.cos(angle), np.sin(angle), np.zeros(_RING)], axis=-1)
    radius = 0.5 * _AROUND * board.diameter_of(index)
    point = transforms.apply(device_from_target, board.point_of(index)[:, None] + radius[:, None, None] * ring)
    seen = models.see_through.view_dir_of_real_point(point, viewpoint)
    shown = models.display.pixel_of_view_dir(seen.value, viewpoint)
    with np.errstate(invalid="ignore"):
        inside = (shown.value > _EDGE_PX) & (shown.value < models.display.panel.size_px - _EDGE_PX)
    whole = np.all(inside & (seen.usable & shown.usable)[..., None], axis=(1, 2))
    return np.asarray(whole.reshape(board.rows, board.columns))
