"""Frames for a moving wearer: head poses and eye positions over time, one PNG per eye and moment.

Frames are written whole, so that an interrupted sequence resumes where it stopped; `sequence.json` beside them says of
which job they are and when, from where and how each was drawn.
"""

import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from wlr_render.errors import BadInputError
from wlr_render.files import output_folder, write_text
from wlr_render.jobs.headset import open_channels, open_eye, require_in_eye_box
from wlr_render.mappings import EyeChannels, EyeMappings
from wlr_render.numerics.arrays import FloatArray
from wlr_render.progress import SILENT, Progress
from wlr_render.rendering.image_files import read_png, write_map, write_png, write_video
from wlr_render.rendering.painters import MeshWarpedPainter, Painter, TracedPainter, WarmStarts, WarpedPainter
from wlr_render.rendering.raster_backends import open_raster_backend
from wlr_render.rendering.ray_tracing import RayRenderer
from wlr_render.rendering.scene import Scene
from wlr_render.rendering.scene_file import load_scene
from wlr_render.rendering.view import write_view
from wlr_render.tracking.eye_trajectory_file import read_eye_trajectory
from wlr_render.tracking.head_trajectory_file import read_head_trajectory
from wlr_render.tracking.trajectory import EyeTrajectory, HeadTrajectory

METHODS = ("raster", "raytrace")
MAP_SUFFIXES = ("tiff", "pfm")
MAPS_FROM = ("depth", "mesh")
_RASTER_ONLY = ("maps", "materials", "resolution", "map_from")
COLOURS = ("red", "green", "blue")
RECORD = "sequence.json"


@dataclass(frozen=True)
class Options:
    """One job.

    Attributes:
        headset: a device, or a model file per eye; three per eye, for red, green and blue, if `per_colour`.
        scene: a shipped scene, a scene file or a mesh.
        head: trajectory file (TUM or EuRoC); None for a head at rest at the world's origin.
        eyes_file: eye trajectory file; None for pupils at rest at the centres of the eye boxes.
        eyes: which eyes to draw.
        method: "raster" (intermediate image and warp) or "raytrace".
        frames_per_second: of the sequence; the moments run over what both trajectories cover.
        frame_limit: at most so many frames; None for all.
        supersample: rays per pixel and axis ("raytrace").
        shadows: whether surfaces cast shadows ("raytrace").
        materials: "own" or "gltf" ("raster").
        resolution: of the intermediate image, as in `WarpedPainter` ("raster").
        map_from: where a world ray meets the scene: in the intermediate image's "depth", or on the "mesh" ("raster").
        maps: also write the warp map of each frame ("raster"), as "tiff" or "pfm", and from where the intermediate
            image was drawn that it leads into; None for none.
        per_colour: whether red, green and blue follow rays of their own, and have maps of their own; a device is traced
            at `headset.PRIMARIES_UM`.
        video: also write EYE.mp4.
        backend: who rasterises.
        out: folder.
    """

    headset: tuple[str, ...]
    scene: str
    head: Path | None = None
    eyes_file: Path | None = None
    eyes: tuple[str, ...] = ("right",)
    method: str = "raster"
    frames_per_second: float = 30.0
    frame_limit: int | None = None
    supersample: int = 1
    shadows: bool = False
    materials: str = "own"
    resolution: float = 1.0
    map_from: str = "depth"
    maps: str | None = None
    per_colour: bool = False
    video: bool = False
    backend: str = "auto"
    out: Path = Path("out/render")


@dataclass(frozen=True)
class Moment:
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


@dataclass(frozen=True)
class Rendered:
    """What a run did."""

    drawn: int
    kept: int
    folder: Path
    videos: tuple[Path, ...]


def run(options: Options, progress: Progress = SILENT) -> Rendered:
    """Draw what is not there yet.

    Raises:
        BadInputError: faulty files, a viewpoint outside the eye box, a folder that holds frames of another job, or
            options that contradict each other; nothing is written then.
    """
    _require_consistent(options)
    channels = {eye: _open_channels(options, number) for number, eye in enumerate(options.eyes)}
    moments = planned_moments(options, {eye: of_eye[len(of_eye) // 2] for eye, of_eye in channels.items()})
    scene = load_scene(options.scene)
    record = _record(options, moments)
    folder = output_folder(options.out)
    _require_same_job(folder, record)
    missing = [moment for moment in moments if not _is_done(folder, moment, options)]
    painters = _painters(options, channels, scene) if missing else {}
    write_text(folder / RECORD, json.dumps(record, indent=1) + "\n")
    if missing:
        for _ in progress(_drawn(folder, options, painters, missing), len(missing), "frames"):
            pass
    videos = tuple(_video(folder, eye, moments, options) for eye in options.eyes) if options.video else ()
    return Rendered(len(missing), len(moments) - len(missing), folder, videos)


def _require_consistent(options: Options) -> None:
    choices = {
        "method": (options.method, METHODS),
        "maps": (options.maps, (None, *MAP_SUFFIXES)),
        "map_from": (options.map_from, MAPS_FROM),
    }
    for name, (chosen, known) in choices.items():
        if chosen not in known:
            raise BadInputError(f"'{chosen}' is no choice for '{name}'; choose from {', '.join(map(str, known))}.")
    if len(options.headset) not in (1, _files_per_eye(options) * len(options.eyes)):
        each = "one model file" if _files_per_eye(options) == 1 else "three model files (red, green, blue)"
        raise BadInputError(
            f"{len(options.headset)} headsets are given for {len(options.eyes)} eyes; give one device, or {each} per "
            "eye in the order of the eyes."
        )
    plain = Options(options.headset, options.scene)
    if options.method == "raytrace" and any(getattr(options, name) != getattr(plain, name) for name in _RASTER_ONLY):
        raise BadInputError(
            "A ray-traced frame has no warp map and no intermediate image, and our own materials; use the method "
            "raster for those."
        )
    if options.method == "raster" and (options.supersample != 1 or options.shadows):
        raise BadInputError("Supersampling and shadows need the method raytrace.")
    if not 0 < options.resolution <= 4:
        raise BadInputError(f"The resolution is {options.resolution}; it must be above 0 and at most 4.")
    if not 0 < options.frames_per_second < np.inf:
        raise BadInputError(f"The frame rate is {options.frames_per_second}; it must be positive and finite.")


def _files_per_eye(options: Options) -> int:
    return len(COLOURS) if options.per_colour else 1


def _open_channels(options: Options, number: int) -> EyeChannels:
    count, eye = _files_per_eye(options), options.eyes[number]
    first = number * count if len(options.headset) > 1 else 0
    specs = options.headset[first : first + count]
    return open_channels(specs, eye) if options.per_colour else (open_eye(specs[0], eye),)


def planned_moments(options: Options, mappings: dict[str, EyeMappings]) -> list[Moment]:
    """When and from where each frame is drawn, in time order.

    Raises:
        BadInputError: trajectories that do not overlap in time, or a viewpoint outside the eye box.
    """
    head = read_head_trajectory(options.head) if options.head else None
    eyes = read_eye_trajectory(options.eyes_file) if options.eyes_file else None
    moments = []
    for index, time_s in enumerate(_times(options, head, eyes)):
        pose = head.at(time_s) if head else np.eye(4)
        for eye in options.eyes:
            viewpoint = eyes.viewpoint_at(eye, time_s) if eyes else mappings[eye].eye_box.centre
            require_in_eye_box(mappings[eye], viewpoint, f"{options.eyes_file} at {time_s:.4f} s, {eye} eye")
            moments.append(Moment(index, float(time_s), eye, viewpoint, pose))
    return moments


def _times(options: Options, head: HeadTrajectory | None, eyes: EyeTrajectory | None) -> FloatArray:
    tracks = [head] if head else []
    spans = [(track.time_s[0], track.time_s[-1]) for track in tracks]
    if eyes:
        spans += [(track.time_s[0], track.time_s[-1]) for eye, track in eyes.tracks.items() if eye in options.eyes]
    if not spans:
        return np.zeros(1)
    start, end = max(first for first, _ in spans), min(last for _, last in spans)
    if end < start:
        files = " and ".join(str(path) for path in (options.head, options.eyes_file) if path)
        raise BadInputError(f"The tracks of {files} do not overlap in time; record them together.")
    times = start + np.arange(int((end - start) * options.frames_per_second + 1e-9) + 1) / options.frames_per_second
    # Rounding must not carry the last moment beyond the tracks.
    return np.asarray(np.minimum(times, end)[: options.frame_limit])


def _record(options: Options, moments: list[Moment]) -> dict[str, Any]:
    """What the folder's frames are, as plain JSON."""
    job = {key: str(value) if isinstance(value, Path) else value for key, value in asdict(options).items()}
    for key in ("out", "video", "frame_limit", "backend"):  # these do not change what a frame shows
        job.pop(key)
    frames = [
        {
            "file": _picture_file(Path(), m).name,
            "time_s": m.time_s,
            "viewpoint_in_device_m": m.viewpoint.tolist(),
            "world_from_device": m.world_from_device.tolist(),
        }
        for m in moments
    ]
    record = {"format": "wlr-sequence", "version": 1, "frame": "openxr", "job": job, "frames": frames}
    return dict(json.loads(json.dumps(record)))


def _require_same_job(folder: Path, record: dict[str, Any]) -> None:
    """Refuse a folder whose frames are of other options, or of trajectories that have been changed since."""
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
        return earlier["job"] == record["job"] and all(old == new for old, new in frames)
    except (json.JSONDecodeError, UnicodeDecodeError, KeyError, TypeError):
        return False


def _map_files(folder: Path, moment: Moment, options: Options) -> list[Path]:
    if options.maps is None:
        return []
    stems = [f"{moment.stem}-{colour}" for colour in COLOURS] if options.per_colour else [moment.stem]
    return [folder / f"{stem}.{options.maps}" for stem in stems]


def _picture_file(folder: Path, moment: Moment) -> Path:
    return folder / f"{moment.stem}.png"


def _view_file(folder: Path, moment: Moment) -> Path:
    return folder / f"{moment.stem}.json"


def _is_done(folder: Path, moment: Moment, options: Options) -> bool:
    maps = _map_files(folder, moment, options)
    beside = [_view_file(folder, moment)] if maps else []
    return all(path.exists() for path in (*maps, *beside, _picture_file(folder, moment)))


def _painters(options: Options, channels: dict[str, EyeChannels], scene: Scene) -> dict[str, Painter]:
    if options.method == "raytrace":
        renderer = RayRenderer(scene)
        return {
            eye: TracedPainter(each, renderer, options.supersample, options.shadows) for eye, each in channels.items()
        }
    raster_backend, resolution = open_raster_backend(scene, options.backend, options.materials), options.resolution
    if options.map_from == "depth":
        return {eye: WarpedPainter(each, raster_backend, resolution) for eye, each in channels.items()}
    renderer = RayRenderer(scene)
    return {eye: MeshWarpedPainter(each, raster_backend, renderer, resolution) for eye, each in channels.items()}


def _drawn(folder: Path, options: Options, painters: dict[str, Painter], moments: list[Moment]) -> Iterator[Moment]:
    last: dict[str, WarmStarts | None] = dict.fromkeys(painters)
    with_maps = options.maps is not None
    for moment in moments:
        eye, pose = moment.eye, moment.world_from_device
        frame = painters[eye].paint(moment.viewpoint, pose, last[eye], with_geometry=with_maps)
        last[eye] = frame.warm_start
        for path, source in zip(_map_files(folder, moment, options), frame.sources if with_maps else (), strict=True):
            write_map(path, source)
        if frame.view is not None:
            write_view(_view_file(folder, moment), frame.view)
        write_png(_picture_file(folder, moment), frame.colour)
        yield moment


def _video(folder: Path, eye: str, moments: list[Moment], options: Options) -> Path:
    pictures = (read_png(_picture_file(folder, moment)) for moment in moments if moment.eye == eye)
    return write_video(folder / f"{eye}.mp4", pictures, options.frames_per_second)
