"""Draw frames for a still or moving wearer, one PNG per eye and time stamp.

Frames are written atomically, so that an interrupted sequence resumes where it stopped; `sequence.json` beside them
holds the options of the job, and the time stamp, viewpoint and head pose of each frame.
"""

import json
from collections.abc import Iterator
from dataclasses import KW_ONLY, asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np

from wlr_render.errors import BadInputError
from wlr_render.files import output_folder, write_text
from wlr_render.jobs.headset import headset_path, open_colours, open_eye, require_in_eye_box
from wlr_render.jobs.options import (
    Backend,
    Eyes,
    MapFrom,
    OnlyWith,
    Options,
    ProgressArgument,
    Range,
    RasterCamera,
    described,
    eyes_of,
)
from wlr_render.mappings import EyeChannels, EyeMappings
from wlr_render.numerics.arrays import FloatArray
from wlr_render.progress import SILENT
from wlr_render.rendering.image_files import read_png, write_map, write_png, write_video
from wlr_render.rendering.painters import Painter, TracedPainter, WarmStarts, raster_painter
from wlr_render.rendering.raster_backends import open_raster_backend
from wlr_render.rendering.ray_tracing import RayRenderer
from wlr_render.rendering.scene import Scene
from wlr_render.rendering.scene_file import load_scene, scene_path
from wlr_render.rendering.view import write_view
from wlr_render.report.blocks import Block, Cell, Picture, Report, ReportTable
from wlr_render.report.save import provenance, save_report
from wlr_render.tracking.eye_trajectory_file import read_eye_trajectory
from wlr_render.tracking.head_trajectory_file import read_head_trajectory
from wlr_render.tracking.trajectory import EyeTrajectory, HeadTrajectory

COLOURS = ("red", "green", "blue")
RECORD = "sequence.json"
_ABSENT_IN_OLD_RECORDS = {"raster_camera": "nearest"}
"""Options that earlier versions did not write, with the only value that they had."""
LONGEST_GAP_S = 1.0
"""Between neighbouring samples of a trajectory; a longer one is a dropout, or a file in milliseconds."""


@dataclass(frozen=True)
class RenderOptions(Options):
    """Options of `render`."""

    headset: Annotated[str, described("A device or a model file (with --red-model: the model fitted in green light).")]
    scene: Annotated[str, described("A shipped scene, a scene file or a mesh.")]
    _: KW_ONLY
    eye: Annotated[Eyes, described("Eyes to draw.")] = "right"
    head: Annotated[
        Path | None, described("Head trajectory, TUM or EuRoC (default: a head at rest at the world's origin).")
    ] = None
    eye_track: Annotated[
        Path | None, described("Eye trajectory (default: pupils at rest at the centres of the eye boxes).")
    ] = None
    frames_per_second: Annotated[
        float, described("Frames per second, over the time that both trajectories cover.", name="--fps"), Range(above=0)
    ] = 30.0
    frame_limit: Annotated[
        int | None,
        described("Maximum number of frames along --head or --eye-track (default: all).", name="--frames"),
        Range(at_least=1),
    ] = None
    method: Annotated[
        Literal["raster", "raytrace"],
        described("Rendering method: an intermediate image that is warped, or a ray for each pixel."),
    ] = "raster"
    supersample: Annotated[
        int, described("Rays per pixel and axis (raytrace only)."), Range(1, 12), OnlyWith("method", ("raytrace",))
    ] = 1
    shadows: Annotated[
        bool, described("Surfaces cast shadows (raytrace only).", flag=True), OnlyWith("method", ("raytrace",))
    ] = False
    materials: Annotated[
        Literal["own", "gltf"],
        described("Shading: the ray tracer's, or glTF materials (raster only, needs OpenGL)."),
        OnlyWith("method", ("raster",)),
    ] = "own"
    resolution: Annotated[
        float,
        described("Resolution of the intermediate image; 1: about the panel's (raster only)."),
        Range(above=0, at_most=4),
        OnlyWith("method", ("raster",)),
    ] = 1.0
    raster_camera: Annotated[RasterCamera, OnlyWith("method", ("raster",))] = "nearest"
    map_from: Annotated[MapFrom, OnlyWith("method", ("raster",))] = "depth"
    maps: Annotated[
        Literal["tiff", "pfm"] | None,
        described("Also write the warp map of each frame, and the view of the intermediate image (raster only)."),
        OnlyWith("method", ("raster",)),
    ] = None
    per_colour: Annotated[
        bool,
        described("Separate rays and warp maps for red, green and blue; a device is traced in all three.", flag=True),
    ] = False
    red_model: Annotated[Path | None, described("Model file in red light; needs --blue-model.")] = None
    blue_model: Annotated[Path | None, described("Model file in blue light; needs --red-model.")] = None
    video: Annotated[bool, described("Also write EYE.mp4 (VP9).", flag=True)] = False
    backend: Annotated[Backend, OnlyWith("method", ("raster",))] = "auto"
    out: Annotated[Path, described("Output folder; frames that are there already are kept.")] = Path("out/render")

    def __post_init__(self) -> None:
        """Check that the models of red and blue light come together, and that several frames have a trajectory."""
        super().__post_init__()
        if self.frame_limit is not None and self.head is None and self.eye_track is None:
            raise BadInputError(
                "--frames is used with --head or --eye-track only; leave it out (one frame of each eye is drawn), or "
                "give a trajectory."
            )
        if (self.red_model is None) != (self.blue_model is None):
            raise BadInputError("--red-model and --blue-model go together; give both or neither.")

    @property
    def has_colours(self) -> bool:
        """Whether red, green and blue have rays of their own."""
        return self.per_colour or self.red_model is not None


@dataclass(frozen=True)
class PlannedFrame:
    """One frame to draw."""

    index: int
    time_s: float
    eye: str
    viewpoint: FloatArray
    world_from_device: FloatArray

    @property
    def stem(self) -> str:
        """Name of its files without the suffix."""
        return f"{self.eye}-{self.index:06d}"


def render(options: RenderOptions, *, progress: ProgressArgument = SILENT) -> Report:
    """Draw the frames of a moving wearer that `options.out` does not hold yet.

    Raises:
        BadInputError: faulty files, a viewpoint outside the eye box, or a folder that holds frames of another job;
            nothing is written then.
    """
    channels: dict[str, EyeChannels] = {eye: _open_channels(options, eye) for eye in eyes_of(options.eye)}
    head, eyes = read_trajectories(options)
    plan = planned_frames(options, {eye: of_eye[len(of_eye) // 2] for eye, of_eye in channels.items()}, head, eyes)
    scene = load_scene(options.scene)
    record = _record(options, plan)
    folder = output_folder(options.out)
    _require_same_job(folder, record)
    missing = [planned for planned in plan if not _is_done(folder, planned, options)]
    painters = _painters(options, channels, scene) if missing else {}
    sequence = write_text(folder / RECORD, json.dumps(record, indent=1) + "\n")
    if missing:
        for _ in progress(_drawn(folder, options, painters, missing), len(missing), "frames"):
            pass
    videos = [_video(folder, eye, plan, options) for eye in channels] if options.video else []
    report = _report(options, plan, len(missing), [sequence, *videos])
    return save_report(replace(report, warnings=_gap_warnings(options, head, eyes)), folder)


def _open_channels(options: RenderOptions, eye: str) -> EyeChannels:
    if options.has_colours:
        return open_colours(options.headset, eye, options.red_model, options.blue_model)
    return (open_eye(options.headset, eye),)


def _report(options: RenderOptions, plan: list[PlannedFrame], drawn: int, files: list[Path]) -> Report:
    kept = len(plan) - drawn
    rows: list[list[Cell]] = []
    blocks: list[Block] = []
    for eye in eyes_of(options.eye):
        own = [planned for planned in plan if planned.eye == eye]
        rows.append([eye, len(own), own[0].time_s, own[-1].time_s])
        first = _picture_file(options.out, own[0])
        blocks.append(Picture(f"First frame, {eye} eye", first, "The image on the panel, before the optics."))
    table = ReportTable("Frames by eye", ["eye", "frames", "first time stamp (s)", "last time stamp (s)"], rows)
    return Report(
        f"Frames of {Path(options.scene).stem} on {Path(options.headset).stem}",
        f"{drawn} frames drawn, {kept} kept from an earlier run: {_counts_of_files(plan, options)} in {options.out}.",
        blocks=[table, *blocks],
        inputs=[*_drawn_from(options), *filter(None, (options.head, options.eye_track))],
        files=files,
        record={"frames_drawn": drawn, "frames_kept": kept},
    )


def _counts_of_files(plan: list[PlannedFrame], options: RenderOptions) -> str:
    maps = sum(len(_map_files(options.out, planned, options)) for planned in plan)
    return f"{len(plan)} PNG" + (f", {maps} {options.maps.upper()}" if options.maps else "")


def _drawn_from(options: RenderOptions) -> list[Path]:
    """Files of the headset and of the scene."""
    models = filter(None, (options.red_model, options.blue_model))
    return [headset_path(options.headset), *models, scene_path(options.scene)]


def read_trajectories(options: RenderOptions) -> tuple[HeadTrajectory | None, EyeTrajectory | None]:
    """Trajectories of head and eyes; None for each that is not given."""
    head = read_head_trajectory(options.head) if options.head else None
    return head, read_eye_trajectory(options.eye_track) if options.eye_track else None


def planned_frames(
    options: RenderOptions, mappings: dict[str, EyeMappings], head: HeadTrajectory | None, eyes: EyeTrajectory | None
) -> list[PlannedFrame]:
    """When and from where each frame is drawn, in time order.

    Raises:
        BadInputError: trajectories that do not overlap in time, or a viewpoint outside the eye box.
    """
    plan = []
    for index, time_s in enumerate(_times(options, head, eyes)):
        pose = head.at(time_s) if head else np.eye(4)
        for eye in mappings:
            viewpoint = eyes.viewpoint_at(eye, time_s) if eyes else mappings[eye].eye_box.centre
            require_in_eye_box(mappings[eye], viewpoint, f"{options.eye_track} at {time_s:.4f} s, {eye} eye")
            plan.append(PlannedFrame(index, float(time_s), eye, viewpoint, pose))
    return plan


def _times(options: RenderOptions, head: HeadTrajectory | None, eyes: EyeTrajectory | None) -> FloatArray:
    spans = [(time_s[0], time_s[-1]) for _, time_s in _sample_times(options, head, eyes)]
    if not spans:
        return np.zeros(1)
    start, end = max(first for first, _ in spans), min(last for _, last in spans)
    if end < start:
        files = " and ".join(str(path) for path in (options.head, options.eye_track) if path)
        raise BadInputError(f"The tracks of {files} do not overlap in time; record them together.")
    times = start + np.arange(int((end - start) * options.frames_per_second + 1e-9) + 1) / options.frames_per_second
    # Rounding must not carry the last frame beyond the tracks.
    return np.asarray(np.minimum(times, end)[: options.frame_limit])


def _sample_times(
    options: RenderOptions, head: HeadTrajectory | None, eyes: EyeTrajectory | None
) -> list[tuple[Path | None, FloatArray]]:
    """File and sample times (n,) of the head and of each eye that is drawn."""
    tracks = eyes.tracks if eyes else {}
    drawn = [(options.eye_track, track.time_s) for eye, track in tracks.items() if eye in eyes_of(options.eye)]
    return [(options.head, head.time_s), *drawn] if head else drawn


def _gap_warnings(options: RenderOptions, head: HeadTrajectory | None, eyes: EyeTrajectory | None) -> list[str]:
    """A sentence for each file with neighbouring samples farther apart than `LONGEST_GAP_S`."""
    gaps: dict[Path | None, float] = {}
    for file, time_s in _sample_times(options, head, eyes):
        gaps[file] = max(gaps.get(file, 0.0), float(np.diff(time_s).max()))
    return [
        f"{file}: neighbouring samples are up to {gap:.3g} s apart, and poses between them are interpolated; are the "
        "times in seconds?"
        for file, gap in gaps.items()
        if gap > LONGEST_GAP_S
    ]


def _record(options: RenderOptions, plan: list[PlannedFrame]) -> dict[str, Any]:
    """What the folder's frames are, as plain JSON."""
    job = {key: str(value) if isinstance(value, Path) else value for key, value in asdict(options).items()}
    for key in ("out", "video", "frame_limit", "backend"):  # these do not change what a frame shows
        job.pop(key)
    job["sha256"] = [file.sha256 for file in provenance(_drawn_from(options), options.out).inputs]
    frames = [
        {
            "file": _picture_file(Path(), m).name,
            "time_s": m.time_s,
            "viewpoint_in_device_m": m.viewpoint.tolist(),
            "world_from_device": m.world_from_device.tolist(),
        }
        for m in plan
    ]
    record = {"format": "wlr-sequence", "version": 1, "frame": "openxr", "job": job, "frames": frames}
    return dict(json.loads(json.dumps(record)))


def _require_same_job(folder: Path, record: dict[str, Any]) -> None:
    """Refuse a folder whose frames are of other options, or of files that have been changed since."""
    path = folder / RECORD
    if path.exists():
        same = _same_job(path, record)
    else:
        same = not any((folder / frame["file"]).exists() for frame in record["frames"])
    if not same:
        raise BadInputError(f"{folder}: holds the frames of another job; choose another folder or empty it.")


def _same_job(path: Path, record: dict[str, Any]) -> bool:
    try:
        earlier = json.loads(path.read_text(encoding="utf-8"))
        frames = zip(earlier["frames"], record["frames"], strict=False)  # either may have been limited to fewer
        job = {**_ABSENT_IN_OLD_RECORDS, **earlier["job"]}
        return job == record["job"] and all(old == new for old, new in frames)
    except (json.JSONDecodeError, UnicodeDecodeError, KeyError, TypeError):
        return False


def _map_files(folder: Path, planned: PlannedFrame, options: RenderOptions) -> list[Path]:
    if options.maps is None:
        return []
    stems = [f"{planned.stem}-{colour}" for colour in COLOURS] if options.has_colours else [planned.stem]
    return [folder / f"{stem}.{options.maps}" for stem in stems]


def _picture_file(folder: Path, planned: PlannedFrame) -> Path:
    return folder / f"{planned.stem}.png"


def _view_file(folder: Path, planned: PlannedFrame) -> Path:
    return folder / f"{planned.stem}.json"


def _is_done(folder: Path, planned: PlannedFrame, options: RenderOptions) -> bool:
    maps = _map_files(folder, planned, options)
    beside = [_view_file(folder, planned)] if maps else []
    return all(path.exists() for path in (*maps, *beside, _picture_file(folder, planned)))


def _painters(options: RenderOptions, channels: dict[str, EyeChannels], scene: Scene) -> dict[str, Painter]:
    if options.method == "raytrace":
        renderer = RayRenderer(scene)
        return {
            eye: TracedPainter(each, renderer, options.supersample, options.shadows) for eye, each in channels.items()
        }
    raster_backend, resolution = open_raster_backend(scene, options.backend, options.materials), options.resolution
    mesh = RayRenderer(scene) if options.map_from == "mesh" else None
    return {
        eye: raster_painter(each, raster_backend, mesh, resolution, options.raster_camera)
        for eye, each in channels.items()
    }


def _drawn(
    folder: Path, options: RenderOptions, painters: dict[str, Painter], plan: list[PlannedFrame]
) -> Iterator[PlannedFrame]:
    last: dict[str, WarmStarts | None] = dict.fromkeys(painters)
    with_maps = options.maps is not None
    for planned in plan:
        eye, pose = planned.eye, planned.world_from_device
        frame = painters[eye].paint(planned.viewpoint, pose, last[eye], with_geometry=with_maps)
        last[eye] = frame.warm_start
        for path, source in zip(_map_files(folder, planned, options), frame.sources if with_maps else (), strict=True):
            write_map(path, source)
        if frame.view is not None:
            write_view(_view_file(folder, planned), frame.view)
        write_png(_picture_file(folder, planned), frame.colour)
        yield planned


def _video(folder: Path, eye: str, plan: list[PlannedFrame], options: RenderOptions) -> Path:
    pictures = (read_png(_picture_file(folder, planned)) for planned in plan if planned.eye == eye)
    return write_video(folder / f"{eye}.mp4", pictures, options.frames_per_second)
