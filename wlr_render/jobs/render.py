"""Draw frames for a still or moving wearer, one PNG per eye and time stamp.

Frames are written atomically and listed when they are finished, so that an interrupted sequence resumes where it
stopped; `sequence.json` beside them holds the options of the job, the hashes of the files that the frames show, and the
time stamp, viewpoint and head pose of each frame. A frame does not depend on which frames were drawn before it.
"""

import contextlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from wlr_render.budget.error_map import ErrorMap, PredictedError
from wlr_render.compositing.raster_painter import raster_painter, traced_instead
from wlr_render.errors import BadInputError
from wlr_render.files import output_folder, write_text
from wlr_render.finished_files import LIST, FinishedFiles
from wlr_render.input_files import hashes_of_inputs, naming
from wlr_render.jobs.budget import BudgetOptions, opened_with_sizes
from wlr_render.jobs.frame_plan import PlannedFrame, gap_warnings, held_warnings, planned_frames, read_trajectories
from wlr_render.jobs.headset import headset_path, open_colours, open_eye
from wlr_render.jobs.job import job
from wlr_render.jobs.options import (
    ProgressArgument,
    eyes_of,
    seed_of,
)
from wlr_render.jobs.render_options import RenderOptions
from wlr_render.jobs.sequence_record import RECORD, require_same_job, sequence_record
from wlr_render.mappings import EyeChannels
from wlr_render.progress import SILENT, Progress
from wlr_render.rendering.image_files import read_png, write_map, write_png, write_video
from wlr_render.rendering.mitsuba_frames import PathTracedPainter, PathTracer
from wlr_render.rendering.painters import Painter, TracedPainter, blank_warnings, is_blank
from wlr_render.rendering.ray_tracing import RayRenderer
from wlr_render.rendering.scene import Scene
from wlr_render.rendering.scene_file import load_scene, scene_path
from wlr_render.rendering.scene_raster import SceneRaster, open_scene_raster
from wlr_render.rendering.view import write_view
from wlr_render.report.blocks import Block, Cell, Picture, Report, ReportTable
from wlr_render.report.save import save_report

COLOURS = ("red", "green", "blue")
_MOST_NAMES = 10  # of changed frames in a warning


@job
def render(options: RenderOptions, *, progress: ProgressArgument = SILENT) -> Report:
    """Draw the frames of a moving wearer that `options.out` does not hold yet.

    Raises:
        BadInputError: faulty files, viewpoints that are all outside the eye box, or a folder that holds frames of
            another job; nothing is written then.
    """
    with hashes_of_inputs() as inputs:
        channels: dict[str, EyeChannels] = {eye: _open_channels(options, eye) for eye in eyes_of(options.eye)}
        scene = load_scene(options.scene)
    raster = _open_raster(options, scene)
    with raster.context if raster else contextlib.nullcontext():
        return _render(options, channels, scene, raster, inputs, progress)


def _render(
    options: RenderOptions,
    channels: dict[str, EyeChannels],
    scene: Scene,
    raster: SceneRaster | None,
    inputs: Mapping[str, str],
    progress: Progress,
) -> Report:
    """Draw what is missing; `inputs` are the hashes of the files read, `raster` is None where frames are ray traced."""
    head, eyes = read_trajectories(options)
    plan = planned_frames(options, {eye: of_eye[len(of_eye) // 2] for eye, of_eye in channels.items()}, head, eyes)
    record = sequence_record(_job(options, raster), inputs, [_frame_record(planned) for planned in plan])
    predicted = _predicted(options, plan)
    folder = output_folder(options.out)
    trajectories = [path for path in (options.head, options.eye_track) if path]
    is_old = require_same_job(folder, record, RenderOptions, trajectories)
    finished = FinishedFiles(folder)
    missing = [planned for planned in plan if finished.not_whole(_files(folder, planned, options))]
    changed = [planned for planned in missing if finished.changed(_files(folder, planned, options))]
    painters = _painters(options, channels, scene, raster) if missing else {}
    sequence = write_text(folder / RECORD, json.dumps(record, indent=1) + "\n")
    if missing:
        for _ in progress(_drawn(folder, options, painters, missing, finished, predicted), len(missing), "frames"):
            pass
    pictures = [_picture_file(folder, planned) for planned in plan]
    videos = [_video(folder, eye, plan, options) for eye in channels] if options.video else []
    warnings = [
        *(traced_instead(raster, options.backend) if options.method == "raster" else []),
        *gap_warnings(options, head, eyes),
        *held_warnings(options, plan),
        *_redrawn_warnings(folder, changed, is_old),
        *blank_warnings([path.name for path in pictures if finished.is_blank(path)], scene.name),
    ]
    report = _report(options, plan, len(missing), predicted, [sequence, folder / LIST, *videos])
    return save_report(replace(report, warnings=warnings), folder)


def _open_channels(options: RenderOptions, eye: str) -> EyeChannels:
    if options.has_colours:
        return open_colours(options.headset, eye, options.red_model, options.blue_model)
    return (open_eye(options.headset, eye),)


def _predicted(options: RenderOptions, plan: list[PlannedFrame]) -> dict[str, PredictedError]:
    """Predicted error of each frame by its stem, if it is asked for."""
    depth_m = options.predicted_error
    if depth_m is None:
        return {}
    maps: dict[str, ErrorMap] = {}
    for eye in eyes_of(options.eye):
        mappings, sizes = opened_with_sizes(BudgetOptions(options.headset), eye)
        with naming(Path(options.headset)):
            maps[eye] = ErrorMap(mappings, sizes)
    return {planned.stem: maps[planned.eye].at(planned.viewpoint, depth_m) for planned in plan}


def _report(
    options: RenderOptions,
    plan: list[PlannedFrame],
    drawn: int,
    predicted: Mapping[str, PredictedError],
    files: list[Path],
) -> Report:
    kept = len(plan) - drawn
    rows: list[list[Cell]] = []
    blocks: list[Block] = []
    for eye in eyes_of(options.eye):
        own = [planned for planned in plan if planned.eye == eye]
        errors = [predicted[planned.stem] for planned in own if predicted]
        stated = [max(each.rms_arcmin for each in errors), max(each.radius_arcmin for each in errors)] if errors else []
        rows.append([eye, len(own), own[0].time_s, own[-1].time_s, *stated])
        first = _picture_file(options.out, own[0])
        blocks.append(Picture(f"First frame, {eye} eye", first, "The image on the panel, before the optics."))
    columns = ["eye", "frames", "first time stamp (s)", "last time stamp (s)"]
    notes = []
    if predicted:
        columns += ["predicted rms (arcmin)", "predicted 95 % (arcmin)"]
        notes = [
            f"Predicted: registration error of points at {options.predicted_error:g} m over the field of view, in the "
            "frame where it is largest. STEM-error.tiff has the map of each frame: rms to the right, upwards and in "
            "all, arcminutes."
        ]
    table = ReportTable("Frames by eye", columns, rows, notes)
    by_frame = [
        {"file": f"{stem}.png", "rms_arcmin": each.rms_arcmin, "radius_arcmin": each.radius_arcmin}
        for stem, each in predicted.items()
    ]
    return Report(
        f"Frames of {Path(options.scene).stem} on {Path(options.headset).stem}",
        f"{drawn} frames drawn, {kept} kept from an earlier run: {_counts_of_files(plan, options)} in {options.out}.",
        blocks=[table, *blocks],
        inputs=[*_drawn_from(options), *filter(None, (options.head, options.eye_track))],
        files=files,
        record={"frames_drawn": drawn, "frames_kept": kept} | ({"predicted_error": by_frame} if by_frame else {}),
    )


def _counts_of_files(plan: list[PlannedFrame], options: RenderOptions) -> str:
    maps = sum(len(_map_files(options.out, planned, options)) for planned in plan)
    return f"{len(plan)} PNG" + (f", {maps} {options.maps.upper()}" if options.maps else "")


def _drawn_from(options: RenderOptions) -> list[Path]:
    """Files of the headset and of the scene."""
    models = filter(None, (options.red_model, options.blue_model))
    return [headset_path(options.headset), *models, scene_path(options.scene)]


def _redrawn_warnings(folder: Path, changed: list[PlannedFrame], is_old: bool) -> list[str]:
    warnings = []
    if changed:
        names = [_picture_file(folder, planned).name for planned in changed]
        more = f" and {len(names) - _MOST_NAMES} more" if len(names) > _MOST_NAMES else ""
        warnings.append(
            f"{folder}: frames had changed since they were drawn, and were drawn again: "
            f"{', '.join(names[:_MOST_NAMES])}{more}."
        )
    if is_old:
        warnings.append(
            f"{folder}: an earlier version, which did not record what it had finished, left frames there; they were "
            "drawn again."
        )
    return warnings


def _open_raster(options: RenderOptions, scene: Scene) -> SceneRaster | None:
    """None where every frame is ray traced.

    Raises:
        BadInputError: warp maps without OpenGL, or a way to make them with --backend cpu.
        MissingGlError: as `open_scene_raster`.
    """
    if options.method != "raster":
        return None
    raster = open_scene_raster(scene, options.backend, options.materials)
    if raster is None and options.maps is not None:
        if options.backend == "cpu":
            raise BadInputError(
                "--maps has no use with --backend cpu: ray-traced frames have no warp map; leave out one."
            )
        raise BadInputError(
            "--maps needs OpenGL, because ray-traced frames have no warp map; leave it out, or install libegl1 and "
            "libgl1 and choose --backend auto."
        )
    if options.backend == "cpu" and options.map_from == "mesh":
        raise BadInputError("--map-from has no use with --backend cpu: frames are ray traced; leave out one of them.")
    return raster


def _job(options: RenderOptions, raster: SceneRaster | None) -> dict[str, Any]:
    """The options that change what a frame shows."""
    job = {key: str(value) if isinstance(value, Path) else value for key, value in asdict(options).items()}
    if raster is None and options.method == "raster":
        job["method"] = "raytrace"
    return {key: job[key] for key in job if key not in ("out", "video", "frame_limit", "backend")}


def _frame_record(planned: PlannedFrame) -> dict[str, Any]:
    record = {
        "file": _picture_file(Path(), planned).name,
        "time_s": planned.time_s,
        "viewpoint_in_device_m": planned.viewpoint.tolist(),
        "world_from_device": planned.world_from_device.tolist(),
    }
    return record | ({"held": True} if planned.held else {})


def _map_files(folder: Path, planned: PlannedFrame, options: RenderOptions) -> list[Path]:
    if options.maps is None:
        return []
    stems = [f"{planned.stem}-{colour}" for colour in COLOURS] if options.has_colours else [planned.stem]
    return [folder / f"{stem}.{options.maps}" for stem in stems]


def _picture_file(folder: Path, planned: PlannedFrame) -> Path:
    return folder / f"{planned.stem}.png"


def _error_file(folder: Path, planned: PlannedFrame) -> Path:
    return folder / f"{planned.stem}-error.tiff"


def _view_file(folder: Path, planned: PlannedFrame) -> Path:
    return folder / f"{planned.stem}.json"


def _files(folder: Path, planned: PlannedFrame, options: RenderOptions) -> list[Path]:
    maps = _map_files(folder, planned, options)
    beside = [_view_file(folder, planned)] if maps else []
    predicted = [_error_file(folder, planned)] if options.predicted_error else []
    return [*maps, *beside, *predicted, _picture_file(folder, planned)]


def _painters(
    options: RenderOptions, channels: dict[str, EyeChannels], scene: Scene, raster: SceneRaster | None
) -> dict[str, Painter]:
    if options.method == "pathtrace":
        tracer = PathTracer(scene, options.bounces)
        return {
            eye: PathTracedPainter(each, tracer, options.samples, seed_of(options.seed, eye))
            for eye, each in channels.items()
        }
    if options.method == "raytrace":
        renderer = RayRenderer(scene)
        return {
            eye: TracedPainter(each, renderer, options.supersample, options.shadows) for eye, each in channels.items()
        }
    needs_rays = raster is None or options.map_from == "mesh"
    mesh = RayRenderer(scene) if needs_rays else None
    return {
        eye: raster_painter(each, raster, mesh, options.map_from, options.resolution, options.raster_camera)
        for eye, each in channels.items()
    }


def _drawn(
    folder: Path,
    options: RenderOptions,
    painters: dict[str, Painter],
    plan: list[PlannedFrame],
    finished: FinishedFiles,
    predicted: Mapping[str, PredictedError],
) -> Iterator[PlannedFrame]:
    """Draw the frames of a plan, one after the other."""
    with_maps = options.maps is not None
    for planned in plan:
        frame = painters[planned.eye].paint(planned.viewpoint, planned.world_from_device, with_geometry=with_maps)
        for path, source in zip(_map_files(folder, planned, options), frame.sources if with_maps else (), strict=True):
            write_map(path, source)
        if frame.view is not None:
            write_view(_view_file(folder, planned), frame.view)
        if predicted:
            write_map(_error_file(folder, planned), predicted[planned.stem].map_arcmin)
        write_png(_picture_file(folder, planned), frame.colour)
        finished.add(_files(folder, planned, options), is_blank(frame.colour))
        yield planned


def _video(folder: Path, eye: str, plan: list[PlannedFrame], options: RenderOptions) -> Path:
    pictures = (read_png(_picture_file(folder, planned)) for planned in plan if planned.eye == eye)
    return write_video(folder / f"{eye}.mp4", pictures, options.frames_per_second)
