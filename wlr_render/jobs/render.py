"""Draw frames for a still or moving wearer, one PNG per eye and time stamp.

Frames are written atomically and listed with their facts when they are finished, so that an interrupted sequence
resumes where it stopped. `metadata.jsonl` has a row for each frame in the end. A frame does not depend on previously
drawn frames. Layers and labels of a frame are in `frame_labels.py`.
"""

import contextlib
import itertools
import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wlr_render.draw.frame_layers import LAYERS
from wlr_render.draw.painters import blank_warnings, saturation_warnings
from wlr_render.draw.raster_painter import traced_instead
from wlr_render.draw.scene_raster import SceneRaster
from wlr_render.errors import BadInputError
from wlr_render.io.atomic_files import output_folder, write_text
from wlr_render.io.kept import LEDGER, Facts, Kept, recipe_of
from wlr_render.jobs.budget import source_table
from wlr_render.jobs.frame_drawing import FrameDrawing, OpenedFiles, files_of, map_files, open_raster, picture_file
from wlr_render.jobs.frame_labels import write_instances
from wlr_render.jobs.frame_plan import (
    METADATA,
    PlannedFrame,
    column_warnings,
    gap_warnings,
    held_warnings,
    planned_frames,
    read_trajectories,
)
from wlr_render.jobs.headset import effect_warnings, headset_path
from wlr_render.jobs.job import job
from wlr_render.jobs.options import ProgressArgument, eyes_of
from wlr_render.jobs.pack import pack_frames
from wlr_render.jobs.render_options import RenderOptions
from wlr_render.report.blocks import Block, Cell, Picture, Plot, Report, ReportTable
from wlr_render.report.plots import curves
from wlr_render.report.save import save_report
from wlr_render.scene.image_files import read_png, write_video
from wlr_render.scene.scene_file import scene_path
from wlr_render.work.progress import SILENT, Progress

_MOST_NAMES = 10  # largest number of changed frames in a warning
_MOST_PLOTTED = 1000  # frames of an eye in a plot, about
_ERROR_BYTES, _MISALIGNMENT_BYTES = 2500, 400  # most of a frame's facts: some 25 sources of errors; five figures


@job
def render(options: RenderOptions, *, progress: ProgressArgument = SILENT) -> Report:
    """Draw the frames of a moving wearer that `options.out` does not hold yet.

    Raises:
        BadInputError: faulty files, viewpoints that are all outside the eye box, or a folder that holds frames of
            another job; nothing is written then.
    """
    opened = OpenedFiles.of(options)
    raster = open_raster(options, opened.scene)
    with raster.context if raster else contextlib.nullcontext():
        return _render(options, opened, raster, progress)


def _render(options: RenderOptions, opened: OpenedFiles, raster: SceneRaster | None, progress: Progress) -> Report:
    """Draw missing frames; `raster` is None if frames are ray traced."""
    head, eyes = read_trajectories(options)
    plan = planned_frames(options, opened.middle(), head, eyes)
    folder = output_folder(options.out)
    finished = _kept(folder, options, opened, raster, plan)
    missing = [planned for planned in plan if finished.unfinished(files_of(folder, planned, options))]
    changed = [planned for planned in missing if finished.changed(files_of(folder, planned, options))]
    drawn = FrameDrawing(options, opened, raster).frames(missing)
    finished.begin()
    for frame in progress(drawn, len(missing), "frames"):
        finished.add(frame.files, frame.facts)
    pictures = [picture_file(folder, planned) for planned in plan]
    rows = [{"file_name": path.name, **finished.facts(path)} for path in pictures]
    joined = [write_text(folder / METADATA, "".join(f"{json.dumps(row)}\n" for row in rows))]
    if "instance" in options.layers:
        panels = {eye: mappings.display.panel for eye, mappings in opened.middle().items()}
        joined.append(write_instances(folder, opened.scene, panels, plan))
    videos = _videos(folder, plan, options) if options.video else []
    packed = pack_frames(folder, rows, opened.sources(options), options, progress) if options.pack else []
    first = reversed([*zip(plan, pictures, strict=True)])
    warnings = [
        *opened.scene.warnings,
        *effect_warnings(options.headset),
        *(traced_instead(raster, options.backend) if options.method == "raster" else []),
        *gap_warnings(options, head, eyes),
        *column_warnings(head, eyes),
        *held_warnings(options, plan),
        *_redrawn_warnings(folder, changed),
        *blank_warnings([row["file_name"] for row in rows if row.get("blank")], opened.scene.name),
        *saturation_warnings(opened.scene, map(read_png, {each.eye: path for each, path in first}.values())),
    ]
    report = _report(options, plan, len(missing), rows, [folder / LEDGER, *joined, *videos, *packed])
    return save_report(replace(report, warnings=warnings), folder)


def _kept(
    folder: Path, options: RenderOptions, opened: OpenedFiles, raster: SceneRaster | None, plan: list[PlannedFrame]
) -> Kept:
    """Open the ledger of the frames.

    Trajectories are compared by the facts of the frames: a longer recording continues a sequence.

    Raises:
        BadInputError: the folder has frames of other options, files or trajectories.
    """
    method = "raytrace" if raster is None and options.method == "raster" else options.method
    layers = [layer for layer in LAYERS if layer in options.layers]
    stated = options.recipe_values(opened.of_options(options)) | {"--method": method, "--layers": layers}
    planned: dict[Path, Facts] = {path: {} for each in plan for path in files_of(folder, each, options)}
    planned |= {picture_file(folder, each): each.facts for each in plan}
    later = _ERROR_BYTES * (options.predicted_error is not None) + _MISALIGNMENT_BYTES * bool(options.misalignment)
    finished = Kept(folder, recipe_of("render", stated, opened.inputs), planned, later_bytes=later)
    for path, facts in planned.items():
        listed = finished.facts(path)
        if any(listed.get(name, value) != value for name, value in facts.items()):
            tracks = [str(track) for track in (options.head, options.eye_track) if track]
            raise finished.refusal(f"{' or '.join(tracks) or 'the eye box'} has changed")
    return finished


def _report(
    options: RenderOptions, plan: list[PlannedFrame], drawn: int, frames: Sequence[Facts], files: list[Path]
) -> Report:
    kept = len(plan) - drawn
    predicted = [frame["predicted_error"] for frame in frames if options.predicted_error]
    misaligned = [frame["misalignment"] for frame in frames if options.misalignment]
    rows: list[list[Cell]] = []
    blocks: list[Block] = []
    for eye in eyes_of(options.eye):
        own = [planned for planned in plan if planned.eye == eye]
        largest = [
            *_largest(_of_eye(predicted, plan, eye), ("rms_arcmin", "radius_arcmin")),
            *_largest(_of_eye(misaligned, plan, eye), ("median_arcmin", "p95_arcmin", "max_arcmin")),
        ]
        rows.append([eye, len(own), own[0].time_s, own[-1].time_s, *largest])
        first = picture_file(options.out, own[0])
        blocks.append(Picture(f"First frame, {eye} eye", first, "The image on the panel, before the optics."))
    columns = ["eye", "frames", "first time stamp (s)", "last time stamp (s)"]
    notes = []
    if predicted:
        columns += ["predicted rms (arcmin)", "predicted 95 % (arcmin)"]
        notes = [
            f"Predicted: registration error of points at {options.predicted_error:g} m over the field of view, in the "
            "frame where it is largest. EYE-NNNNNN-error.tiff has the map of each frame: rms to the right, upwards and "
            "in all, arcminutes."
        ]
    if options.misalignment is not None:
        columns += ["median misalignment (arcmin)", "95 % misalignment (arcmin)", "max misalignment (arcmin)"]
        notes.append(
            "Misalignment: angle at the eye between the frame's content and the real points, through the exact optics "
            f"of {options.misalignment}, in the frame where each figure is largest."
        )
        blocks = [*_misalignment_plot(plan, misaligned), *blocks]
    blocks = [ReportTable("Frames by eye", columns, rows, notes), *_source_tables(predicted, plan), *blocks]
    truth = [headset_path(options.misalignment)] if options.misalignment else []
    by_frame = [{"file": f"{planned.stem}.png", **each} for planned, each in zip(plan, predicted, strict=False)]
    count = "1 frame" if drawn == 1 else f"{drawn} frames"
    return Report(
        f"Frames of {Path(options.scene).stem} on {Path(options.headset).stem}",
        f"{count} drawn, {kept} kept from an earlier run: {_counts_of_files(plan, options)} in {options.out}.",
        blocks=blocks,
        inputs=list(dict.fromkeys([*_drawn_from(options), *truth, *filter(None, (options.head, options.eye_track))])),
        files=files,
        record={"frames_drawn": drawn, "frames_kept": kept} | ({"predicted_error": by_frame} if by_frame else {}),
    )


def _source_tables(predicted: Sequence[Facts], plan: list[PlannedFrame]) -> list[ReportTable]:
    """Return a table of the predicted errors by source, over all frames of each eye; none without predicted errors."""
    found = {}
    for eye in dict.fromkeys(planned.eye for planned in plan):
        own = [each for each in _of_eye(predicted, plan, eye) if each["rms_arcmin"] is not None]
        if own:
            found[eye] = _over_frames(own)
    notes = [f"Predicted registration error, rms over all frames of an eye; {METADATA} has each frame's."]
    return [source_table("Predicted error by source", found, "eye", notes)] if found else []


def _over_frames(frames: Sequence[Facts]) -> Facts:
    """Return the rms over frames of their predicted errors, and of each source's, the largest first."""
    square = dict[str, float]()
    for frame in frames:
        for each in frame["sources"]:
            square[each["name"]] = square.get(each["name"], 0.0) + each["rms_arcmin"] ** 2 / len(frames)
    largest_first = sorted(square.items(), key=lambda each: -each[1])
    whole = float(np.sqrt(np.mean([frame["rms_arcmin"] ** 2 for frame in frames])))
    return {"rms_arcmin": whole, "sources": [{"name": name, "rms_arcmin": each**0.5} for name, each in largest_first]}


def _of_eye(labels: Sequence[Facts], plan: list[PlannedFrame], eye: str) -> list[Facts]:
    """Facts of the frames of an eye; none where no frame has any."""
    return [each for each, planned in zip(labels, plan, strict=False) if planned.eye == eye]


def _largest(labels: Sequence[Facts], names: Sequence[str]) -> list[Cell]:
    """Largest values over the frames that have one; none without labels."""
    return [max((each[name] for each in labels if each[name] is not None), default=None) for name in names if labels]


def _misalignment_plot(plan: list[PlannedFrame], misaligned: Sequence[Facts]) -> list[Plot]:
    """Misalignment over time, if there are several frames."""
    lines = {}
    for eye in dict.fromkeys(planned.eye for planned in plan):
        own = [(planned.time_s, each) for planned, each in zip(plan, misaligned, strict=True) if planned.eye == eye]
        own = own[:: max(1, len(own) // _MOST_PLOTTED)]
        for name, key in (("median", "median_arcmin"), ("95 %", "p95_arcmin")):
            shown = [np.nan if each[key] is None else each[key] for _, each in own]
            lines[f"{eye} eye, {name}"] = [time_s for time_s, _ in own], shown
    if len(plan) == len(lines) // 2:
        return []
    return [curves("Misalignment of the frames", lines, ("time (s)", "misalignment (arcmin)"), grouped=True)]


def _counts_of_files(plan: list[PlannedFrame], options: RenderOptions) -> str:
    maps = sum(len(map_files(options.out, planned, options)) for planned in plan)
    layers = f", {len(plan)} EXR" if options.layers else ""
    of_each = f"{len(plan) // 2} of each eye, " if options.eye == "both" else ""
    return f"{of_each}{len(plan)} PNG" + (f", {maps} {options.maps.upper()}" if options.maps else "") + layers


def _drawn_from(options: RenderOptions) -> list[Path]:
    """Files of the headset and of the scene."""
    models = filter(None, (options.red_model, options.blue_model))
    return [headset_path(options.headset), *models, scene_path(options.scene)]


def _redrawn_warnings(folder: Path, changed: list[PlannedFrame]) -> list[str]:
    if not changed:
        return []
    names = [picture_file(folder, planned).name for planned in changed]
    more = f" and {len(names) - _MOST_NAMES} more" if len(names) > _MOST_NAMES else ""
    return [
        f"{folder}: frames had changed since they were drawn, and were drawn again: "
        f"{', '.join(names[:_MOST_NAMES])}{more}."
    ]


def _videos(folder: Path, plan: list[PlannedFrame], options: RenderOptions) -> list[Path]:
    """Write a video of each eye, and one of both side by side."""
    pictures = {eye: [picture_file(folder, each) for each in plan if each.eye == eye] for eye in eyes_of(options.eye)}
    rate = options.frames_per_second
    videos = [write_video(folder / f"{eye}.mp4", map(read_png, own), rate) for eye, own in pictures.items()]
    if options.eye == "both":
        pairs = zip(pictures["left"], pictures["right"], strict=True)
        videos.append(write_video(folder / "stereo.mp4", itertools.starmap(_side_by_side, pairs), rate))
    return videos


def _side_by_side(left: Path, right: Path) -> NDArray[np.uint8]:
    pictures = read_png(left), read_png(right)
    if pictures[0].shape != pictures[1].shape:
        raise BadInputError(
            f"{left} and {right.name} have different sizes, so that no video has both; leave out --video, or draw one "
            "eye. The PNG frames are complete."
        )
    return np.concatenate(pictures, axis=1)
