"""Draw frames for a still or moving wearer, one PNG per eye and time stamp.

Frames are written atomically, and listed with their facts once all their files exist, so that an interrupted sequence
resumes where it stopped. At the end, `metadata.jsonl` has a row for each frame. A frame does not depend on previously
drawn frames. `frame_labels.py` writes the layers and labels of a frame.
"""

import contextlib
import itertools
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

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
from wlr_render.jobs.frame_drawing import FrameDrawing, OpenedFiles, files_of, map_files, named_files, open_raster
from wlr_render.jobs.frame_labels import write_instances
from wlr_render.jobs.frame_plan import (
    METADATA,
    PlannedFrame,
    column_warnings,
    gap_warnings,
    held_warnings,
    motion_of,
    planned_frames,
)
from wlr_render.jobs.headset import effect_warnings
from wlr_render.jobs.job import job
from wlr_render.jobs.options import ProgressArgument, eyes_of
from wlr_render.jobs.pack import pack_frames
from wlr_render.jobs.render_options import RenderOptions
from wlr_render.report.blocks import Block, Cell, Picture, Plot, Report, ReportTable, table
from wlr_render.report.plots import curves
from wlr_render.scene.image_files import read_png, write_video
from wlr_render.work.progress import SILENT, Progress

_MOST_NAMES = 10  # largest number of changed frames in a warning
_MOST_PLOTTED = 1000  # approximate largest number of an eye's frames in a plot
_ERROR_BYTES, _MISALIGNMENT_BYTES = 2500, 400  # most bytes of a frame's facts: some 25 error sources; five figures


@job
def render(options: RenderOptions, *, progress: ProgressArgument = SILENT) -> Report:
    """Draw the frames of a moving wearer that `options.out` does not contain yet.

    Raises:
        BadInputError: faulty files, viewpoints that are all outside the eye box, or a folder with frames of another
            job; nothing is written then.
    """
    opened = OpenedFiles.of(options)
    raster = open_raster(options, opened.scene)
    with raster.context if raster else contextlib.nullcontext():
        return _render(options, opened, raster, progress)


def _render(options: RenderOptions, opened: OpenedFiles, raster: SceneRaster | None, progress: Progress) -> Report:
    """Draw missing frames; `raster` is None if frames are ray traced."""
    motion = motion_of(options)
    plan = planned_frames(motion, opened.middle())
    folder = output_folder(options.out)
    finished = _kept(folder, options, opened, raster, plan)
    missing = [planned for planned in plan if finished.unfinished(files_of(folder, planned, options))]
    changed = [planned for planned in missing if finished.changed(files_of(folder, planned, options))]
    with contextlib.closing(FrameDrawing(options, opened, raster).frames(missing)) as drawn:
        finished.begin()
        for frame in progress(drawn, len(missing), "frames"):
            finished.add(frame.files, frame.facts)
    pictures = [planned.file(folder) for planned in plan]
    rows = [{"file_name": path.name, **finished.facts(path)} for path in pictures]
    joined = [write_text(folder / METADATA, "".join(f"{json.dumps(row)}\n" for row in rows))]
    if "instance" in options.layers:
        panels = {eye: mappings.display.panel for eye, mappings in opened.middle().items()}
        joined.append(write_instances(folder, opened.scene, panels, plan))
    videos = _videos(folder, plan, options) if options.video else []
    packed = pack_frames(folder, rows, opened.sources(options), options, progress) if options.pack else []
    first = reversed([*zip(plan, pictures, strict=True)])
    blank = [row for row in rows if row.get("blank")]
    places = [[line[3] for line in row["world_from_device"][:3]] for row in blank]
    warnings = [
        *opened.scene.warnings,
        *effect_warnings(options.headset),
        *(traced_instead(raster, options.backend) if options.method == "raster" else []),
        *gap_warnings(motion, opened.channels),
        *column_warnings(motion),
        *held_warnings(motion, plan),
        *_redrawn_warnings(folder, changed),
        *blank_warnings([row["file_name"] for row in blank], opened.scene.name, *places[:1]),
        *saturation_warnings(opened.scene, map(read_png, {each.eye: path for each, path in first}.values())),
    ]
    report = _report(options, plan, len(missing), rows, [folder / LEDGER, *joined, *videos, *packed])
    return replace(report, warnings=warnings)


def _kept(
    folder: Path, options: RenderOptions, opened: OpenedFiles, raster: SceneRaster | None, plan: list[PlannedFrame]
) -> Kept:
    """Open the ledger of the frames.

    Trajectories are compared by the facts of the frames, so that a longer recording can continue a sequence.

    Raises:
        BadInputError: the folder has frames of other options, files or trajectories.
    """
    method = "raytrace" if raster is None and options.method == "raster" else options.method
    layers = [layer for layer in LAYERS if layer in options.layers]
    stated = options.recipe_values(opened.of_options(options)) | {"--method": method, "--layers": layers}
    planned: dict[Path, Facts] = {path: {} for each in plan for path in files_of(folder, each, options)}
    planned |= {each.file(folder): each.facts for each in plan}
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
    eyes: dict[str, list[Facts]] = {
        eye: [frame for frame in frames if frame["eye"] == eye] for eye in eyes_of(options.eye)
    }
    columns: dict[str, Callable[[Any], Cell]] = {
        "frames": len,
        "first time stamp (s)": lambda own: own[0]["time_s"],
        "last time stamp (s)": lambda own: own[-1]["time_s"],
    }
    notes, blocks = list[str](), list[Block]()
    if options.predicted_error:
        columns |= {
            "predicted rms (arcmin)": _largest("predicted_error", "rms_arcmin"),
            "predicted 95 % (arcmin)": _largest("predicted_error", "radius_arcmin"),
        }
        notes.append(
            f"Predicted: registration error of points at {options.predicted_error:g} m over the field of view, in the "
            "frame where it is largest. EYE-NNNNNN-error.tiff has the map of each frame: rms to the right, upwards and "
            "in all, arcminutes."
        )
        blocks += _source_tables(eyes)
    if options.misalignment is not None:
        columns |= {
            f"{head} misalignment (arcmin)": _largest("misalignment", f"{key}_arcmin")
            for head, key in (("median", "median"), ("95 %", "p95"), ("max", "max"))
        }
        notes.append(
            "Misalignment: angle at the eye between the frame's content and the real points, through the exact optics "
            f"of {options.misalignment}, in the frame where each figure is largest."
        )
        blocks += _misalignment_plot(eyes)
    blocks = [table("Frames by eye", eyes.items(), columns, notes, name="eye"), *blocks]
    for eye, own in eyes.items():
        first = options.out / own[0]["file_name"]
        blocks.append(Picture(f"First frame, {eye} eye", first, "The image on the panel, before the optics."))
    by_frame = [{"file": each["file_name"], **each["predicted_error"]} for each in frames if options.predicted_error]
    count = "1 frame" if drawn == 1 else f"{drawn} frames"
    return Report(
        f"Frames of {Path(options.scene).stem} on {Path(options.headset).stem}",
        f"{count} drawn, {kept} kept from an earlier run: {_counts_of_files(plan, options)} in {options.out}.",
        blocks=blocks,
        inputs=list(dict.fromkeys([*named_files(options).values(), *filter(None, (options.head, options.eye_track))])),
        files=files,
        record={"frames_drawn": drawn, "frames_kept": kept} | ({"predicted_error": by_frame} if by_frame else {}),
    )


def _source_tables(eyes: Mapping[str, Sequence[Facts]]) -> list[ReportTable]:
    """Return a table of the predicted errors by source, over all frames of each eye; none without predicted errors."""
    found = {eye: [each["predicted_error"] for each in own] for eye, own in eyes.items()}
    known = {eye: [each for each in own if each["rms_arcmin"] is not None] for eye, own in found.items()}
    over_frames = {eye: _over_frames(own) for eye, own in known.items() if own}
    notes = [f"Predicted registration error, rms over all frames of an eye; {METADATA} has each frame's."]
    return [source_table("Predicted error by source", over_frames, "eye", notes)] if over_frames else []


def _over_frames(frames: Sequence[Facts]) -> Facts:
    """Return the rms of the predicted errors over frames, and of each source's, the largest first."""
    square = dict[str, float]()
    for frame in frames:
        for each in frame["sources"]:
            square[each["name"]] = square.get(each["name"], 0.0) + each["rms_arcmin"] ** 2 / len(frames)
    largest_first = sorted(square.items(), key=lambda each: -each[1])
    whole = float(np.sqrt(np.mean([frame["rms_arcmin"] ** 2 for frame in frames])))
    return {"rms_arcmin": whole, "sources": [{"name": name, "rms_arcmin": each**0.5} for name, each in largest_first]}


def _largest(kind: str, name: str) -> Callable[[Sequence[Facts]], Cell]:
    """Return a column of the largest value over the frames that have one."""
    return lambda own: max((each[kind][name] for each in own if each[kind][name] is not None), default=None)


def _misalignment_plot(eyes: Mapping[str, Sequence[Facts]]) -> list[Plot]:
    """Plot the misalignment over time, if there are several frames."""
    lines = {}
    for eye, own in eyes.items():
        plotted = own[:: max(1, len(own) // _MOST_PLOTTED)]
        for name, key in (("median", "median_arcmin"), ("95 %", "p95_arcmin")):
            shown = [np.nan if (value := each["misalignment"][key]) is None else value for each in plotted]
            lines[f"{eye} eye, {name}"] = [each["time_s"] for each in plotted], shown
    if all(len(own) == 1 for own in eyes.values()):
        return []
    return [curves("Misalignment of the frames", lines, ("time (s)", "misalignment (arcmin)"), grouped=True)]


def _counts_of_files(plan: list[PlannedFrame], options: RenderOptions) -> str:
    maps = sum(len(map_files(options.out, planned, options)) for planned in plan)
    layers = f", {len(plan)} EXR" if options.layers else ""
    of_each = f"{len(plan) // 2} of each eye, " if options.eye == "both" else ""
    return f"{of_each}{len(plan)} PNG" + (f", {maps} {options.maps.upper()}" if options.maps else "") + layers


def _redrawn_warnings(folder: Path, changed: list[PlannedFrame]) -> list[str]:
    if not changed:
        return []
    names = [planned.file(folder).name for planned in changed]
    more = f" and {len(names) - _MOST_NAMES} more" if len(names) > _MOST_NAMES else ""
    return [
        f"{folder}: frames had changed since they were drawn, and were drawn again: "
        f"{', '.join(names[:_MOST_NAMES])}{more}."
    ]


def _videos(folder: Path, plan: list[PlannedFrame], options: RenderOptions) -> list[Path]:
    """Write a video of each eye, and one of both side by side."""
    pictures = {eye: [each.file(folder) for each in plan if each.eye == eye] for eye in eyes_of(options.eye)}
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
