"""Drawing of frames and writing of their files, in the process of the job or in its workers.

`FrameDrawing.frames` draws in both cases. In the process of the job, threads write the files of a frame while the next
frames are drawn. Each worker opens the headset, the scene and OpenGL, and keeps them for its next frames, also of other
jobs with the same files.
"""

import contextlib
import itertools
import platform
from collections import deque
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any

from wlr_render.budget.error_map import ErrorMap
from wlr_render.draw.frame_layers import INSTANCE, frame_layers
from wlr_render.draw.mitsuba_frames import PathTracedPainter, PathTracer
from wlr_render.draw.painters import Frame, Painter, TracedPainter, is_blank
from wlr_render.draw.raster_painter import WarpedPainter
from wlr_render.draw.ray_tracing import RayRenderer
from wlr_render.draw.scene_raster import SceneRaster, open_scene_raster
from wlr_render.draw.thread_pool import in_background
from wlr_render.errors import BadInputError
from wlr_render.io.input_files import hashes_of_inputs, may_refer_outside, outside_references, prefix_errors
from wlr_render.io.kept import Facts, Signature, signatures_of
from wlr_render.jobs.budget import opened_with_sizes
from wlr_render.jobs.budget_options import BudgetOptions
from wlr_render.jobs.frame_labels import (
    LABELS_FILE,
    LAYERS_FILE,
    frame_misalignment,
    named_annotations,
    write_labels,
    write_layers,
)
from wlr_render.jobs.frame_plan import PlannedFrame
from wlr_render.jobs.headset import headset_path, is_model, open_channels
from wlr_render.jobs.options import eyes_of, seed_of
from wlr_render.jobs.render_options import RenderOptions
from wlr_render.mappings import COLOURS, Eye, EyeChannels, middle_channel
from wlr_render.optics.traced_mappings import TRACED
from wlr_render.scene.exr_file import require_exr
from wlr_render.scene.image_files import write_map, write_png
from wlr_render.scene.scene import Scene
from wlr_render.scene.scene_file import load_scene, scene_path
from wlr_render.warp.view import write_view
from wlr_render.work.workers import LOCAL, as_finished, usable_cores

_Write = Callable[[], object]
_FRAMES_OF_A_BLOCK = 8  # most frames per block; an interrupted run may lose this many per worker
_UNWRITTEN = 7  # most frames waiting to be written; one of 1440 x 1600 px with all layers and maps takes 0.2 GB
_BLOCKS = 64  # fewest blocks, given enough frames; with fewer blocks, workers wait for the last one


@dataclass(frozen=True, eq=False)
class OpenedFiles:
    """Opened files of a job.

    Attributes:
        channels: mappings for drawing, by eye.
        truths: exact mappings for misalignment, by eye; empty without misalignment.
        scene: the scene.
        inputs: hashes of the files read, by path.
    """

    channels: Mapping[str, EyeChannels]
    truths: Mapping[str, Eye]
    scene: Scene
    inputs: Mapping[str, str]

    @classmethod
    def of(cls, options: RenderOptions) -> "OpenedFiles":
        """Read the files that the options name.

        Raises:
            BadInputError: a file is faulty.
        """
        with hashes_of_inputs() as inputs:
            channels = open_channels(
                options.headset, eyes_of(options.eye), options.has_colours, options.red_model, options.blue_model
            )
            return cls(channels, _open_truths(options, channels), load_scene(options.scene), inputs)

    def of_options(self, options: RenderOptions) -> dict[str, str]:
        """Return the hashes of the files that options name, by option."""
        return {name: self.inputs[str(path)] for name, path in named_files(options).items()}

    def sources(self, options: RenderOptions) -> dict[str, str]:
        """Return the names and hashes of the headset and of the scene, without local paths, for published data sets."""
        hashes, first = self.of_options(options), next(iter(self.middle().values()))
        names = {"headset": first.name.removesuffix(TRACED), "scene": self.scene.name}
        return names | {f"{name}_sha256": hashes[name] for name in names}

    def middle(self) -> dict[str, Eye]:
        """Return the only or the green channel of each eye."""
        return {eye: middle_channel(of_eye) for eye, of_eye in self.channels.items()}


def named_files(options: RenderOptions) -> dict[str, Path]:
    """Return the files of headset, scene and true device, by the option that names each."""
    paths = {
        "headset": headset_path(options.headset),
        "red_model": options.red_model,
        "blue_model": options.blue_model,
        "scene": scene_path(options.scene),
        "misalignment": headset_path(options.misalignment) if options.misalignment else None,
    }
    return {name: path for name, path in paths.items() if path}


def _open_truths(options: RenderOptions, channels: Mapping[str, EyeChannels]) -> dict[str, Eye]:
    """Open the exact mappings of each eye, if misalignment is requested.

    Raises:
        BadInputError: the truth is not a device, or its panel differs from the headset's.
    """
    device = options.misalignment
    if device is None:
        return {}
    if is_model(device):
        raise BadInputError(
            f"--misalignment {device}: is a fitted model; name the device, whose exact optics the eye looks through."
        )
    opened = open_channels(device, channels, options.has_colours)
    truths = {eye: middle_channel(of_eye) for eye, of_eye in opened.items()}
    for eye, truth in truths.items():
        if truth.display.panel != channels[eye][0].display.panel:
            raise BadInputError(
                f"--misalignment {device}: has another panel than {options.headset}; name the device that the headset "
                "is a model of; for a device file give that file again."
            )
    return truths


def open_raster(options: RenderOptions, scene: Scene) -> SceneRaster | None:
    """Open the rasteriser; None if frames are ray traced.

    Raises:
        BadInputError: warp maps without OpenGL.
        MissingGlError: as `open_scene_raster`.
    """
    if options.method != "raster":
        return None
    raster = open_scene_raster(scene, options.backend, options.materials)
    if raster is None and options.maps is not None:
        if options.backend == "cpu":
            raise BadInputError(
                "--maps has no effect with --backend cpu: ray-traced frames have no warp map; leave out one."
            )
        raise BadInputError(
            "--maps needs OpenGL, because ray-traced frames have no warp map; leave it out, or install libegl1 and "
            "libgl1 and choose --backend auto."
        )
    return raster


_ERROR, _VIEW = "-error.tiff", ".json"  # name endings of a frame's files


def map_files(folder: Path, planned: PlannedFrame, options: RenderOptions) -> list[Path]:
    """Return the warp map files of a frame; none unless `--maps` is given."""
    colours = [f"-{colour}" for colour in COLOURS] if options.has_colours else [""]
    return [planned.file(folder, f"{colour}.{options.maps}") for colour in colours if options.maps]


def files_of(folder: Path, planned: PlannedFrame, options: RenderOptions) -> list[Path]:
    """Return all files of a frame, the panel image last."""
    is_written = {
        _VIEW: options.maps,
        _ERROR: options.predicted_error,
        LAYERS_FILE: options.layers,
        LABELS_FILE: "instance" in options.layers,
        ".png": True,
    }
    others = [planned.file(folder, suffix) for suffix, wanted in is_written.items() if wanted]
    return [*map_files(folder, planned, options), *others]


@dataclass(frozen=True)
class DrawnFrame:
    """The files of a frame with their signatures, the picture last, and its facts."""

    files: Mapping[Path, Signature]
    facts: Facts


@dataclass(frozen=True, eq=False)
class FrameDrawing:
    """Drawing of frames and writing of their files.

    It opens the painters at the first frame, because a process whose workers draw does not need them.

    Attributes:
        options: options of the job.
        opened: opened files of the job.
        raster: the rasteriser; None if frames are not rasterised.
    """

    options: RenderOptions
    opened: OpenedFiles
    raster: SceneRaster | None

    def frames(self, plan: Sequence[PlannedFrame]) -> Generator[DrawnFrame]:
        """Return a generator of frames, drawn in order by this process, or by workers in the order of completion.

        Closing it stops the writing of files.

        Raises:
            BadInputError: no cluster answers, or something that the options need is missing; nothing is written then.
            MissingExtraError: a library that the options need is not installed.
        """
        if self.options.layers:
            require_exr("--layers")
        if self.options.worker_pool == LOCAL:
            if plan:
                _ = self._painters, self._error_maps
            # A path-traced frame takes minutes, so that each is listed before the next one begins.
            most = 1 if self.options.method == "pathtrace" else min(usable_cores() + 1, _UNWRITTEN)
            return in_background(self.writes(plan, self.options.out), most)
        size = min(max(len(plan) // _BLOCKS, 1), _FRAMES_OF_A_BLOCK)
        blocks = [self.block(plan[start : start + size]) for start in range(0, len(plan), size)]
        drawn = as_finished(draw_block, blocks, self.options.worker_pool, self.options.out)
        return (frame for block in drawn for frame in block)

    def block(self, plan: Sequence[PlannedFrame]) -> "FrameBlock":
        """Return a block of frames for a worker."""
        return FrameBlock(self.options, self.opened.inputs, self.raster is not None, may_refer_outside(), plan)

    @cached_property
    def _renderer(self) -> RayRenderer:
        return RayRenderer(self.opened.scene)

    @cached_property
    def _painters(self) -> Mapping[str, Painter]:
        """Painter of each eye."""
        options, channels, raster = self.options, self.opened.channels, self.raster
        if options.method == "pathtrace":
            tracer = PathTracer(self.opened.scene, options.bounces)
            return {
                eye: PathTracedPainter(each, tracer, options.samples, seed_of(options.seed, eye))
                for eye, each in channels.items()
            }
        if raster is None:
            return {
                eye: TracedPainter(each, self._renderer, options.supersample, options.shadows)
                for eye, each in channels.items()
            }
        return {eye: WarpedPainter(each, raster, options.resolution) for eye, each in channels.items()}

    @cached_property
    def _error_maps(self) -> Mapping[str, ErrorMap]:
        """Predictors of the error by eye, if the options ask for predicted errors."""
        maps = {}
        for eye in self.opened.channels if self.options.predicted_error else ():
            mappings, sizes = opened_with_sizes(BudgetOptions(self.options.headset), eye)
            with prefix_errors(Path(self.options.headset)):
                maps[eye] = ErrorMap(mappings, sizes)
        return maps

    def writes(self, plan: Sequence[PlannedFrame], folder: Path) -> Iterator[Callable[[], DrawnFrame]]:
        """Draw frames, and yield for each a function that writes its files into a folder; any thread may call it.

        A rasterised frame is read back only after the next one has been submitted to the GPU.
        """
        painted = deque[tuple[PlannedFrame, Frame]]()
        for planned in plan:
            painted.append((planned, self._paint(planned)))
            if len(painted) > 1 or self.raster is None:
                yield self._write_of(*painted.popleft(), folder)
        while painted:
            yield self._write_of(*painted.popleft(), folder)

    def _paint(self, planned: PlannedFrame) -> Frame:
        with_geometry = self.options.maps is not None or bool(self.opened.truths)
        painter = self._painters[planned.eye]
        return painter.paint(planned.viewpoint, planned.world_from_device, with_geometry=with_geometry)

    def _write_of(self, planned: PlannedFrame, frame: Frame, folder: Path) -> Callable[[], DrawnFrame]:
        """Label a painted frame, and return the function that writes its files."""
        options, colour = self.options, frame.colour
        labels, writes = self._label(folder, planned, frame)
        if options.maps is not None:
            maps = zip(map_files(folder, planned, options), frame.sources, strict=True)
            writes += [partial(write_map, *each) for each in maps]
            if frame.view is not None:
                writes.append(partial(write_view, planned.file(folder, _VIEW), frame.view))

        def write() -> DrawnFrame:
            for write_file in writes:
                write_file()
            write_png(planned.file(folder), colour)
            facts = planned.facts | {"blank": is_blank(colour)} | labels
            return DrawnFrame(signatures_of(files_of(folder, planned, options)), facts)

        return write

    def _label(self, folder: Path, planned: PlannedFrame, frame: Frame) -> tuple[dict[str, Any], list[_Write]]:
        """Return the misalignment and predicted error of a frame, if requested, and functions that write its files.

        These files are its layers, its instances and its map of predicted errors.
        """
        facts, writes = dict[str, Any](), list[_Write]()
        layers, depth_m = self.options.layers, self.options.predicted_error
        if layers:
            channels = frame_layers(self._renderer, frame.ray_map, planned.world_from_device, layers)
            writes.append(partial(write_layers, planned.file(folder, LAYERS_FILE), planned, channels, layers))
            if "instance" in layers:
                annotations = named_annotations(channels[INSTANCE], self.opened.scene)
                writes.append(partial(write_labels, planned.file(folder, LABELS_FILE), annotations))
        if self.opened.truths:
            facts["misalignment"] = frame_misalignment(self.opened.truths[planned.eye], planned, frame)
        if depth_m is not None:
            error = self._error_maps[planned.eye].at(planned.viewpoint, depth_m)
            writes.append(partial(write_map, planned.file(folder, _ERROR), error.map_arcmin))
            facts["predicted_error"] = error.record
        return facts, writes


@dataclass(frozen=True, eq=False)
class FrameBlock:
    """Frames that a worker draws.

    Attributes:
        options: options of the job.
        inputs: hashes of the files that the job has read, by path.
        has_opengl: whether the job has opened OpenGL.
        refers_outside: whether the job's files may refer to files in other folders.
        plan: the frames.
    """

    options: RenderOptions
    inputs: Mapping[str, str]
    has_opengl: bool
    refers_outside: bool
    plan: Sequence[PlannedFrame]


def draw_block(block: FrameBlock) -> list[DrawnFrame]:
    """Draw the frames of a block in a worker.

    Raises:
        BadInputError: the worker has different files or no OpenGL.
    """
    drawing = _kept_drawing(block)
    return [write() for write in drawing.writes(block.plan, block.options.out)]


_kept: dict[str, tuple[FrameDrawing, contextlib.ExitStack]] = {}
"""What this worker has opened for the last job whose frames it drew, and what closes it."""
_MOTION = ("--head", "--eye-track", "--fps")
"""Options that select the frames, which workers do not depend on."""


def _kept_drawing(block: FrameBlock) -> FrameDrawing:
    stated = block.options.recipe_values() | {"backend": block.options.backend}
    key = repr([*(item for item in stated.items() if item[0] not in _MOTION), *sorted(block.inputs.items())])
    if key not in _kept:
        for _, opened in _kept.values():
            opened.close()
        _kept.clear()
        _kept[key] = _open(block)
    return _kept[key][0]


def _open(block: FrameBlock) -> tuple[FrameDrawing, contextlib.ExitStack]:
    with outside_references() if block.refers_outside else contextlib.nullcontext():
        opened = OpenedFiles.of(block.options)
    # Compare in the order of reading: paths of shipped files differ between installations.
    both = itertools.zip_longest(opened.inputs.items(), block.inputs.items(), fillvalue=("", ""))
    for (path, sha256), (path_there, sha256_there) in both:
        if sha256 != sha256_there:
            raise BadInputError(
                f"{path or path_there}: the worker on {platform.node()} reads another file than the machine "
                "that started the job; give all machines the same files, and continue."
            )
    raster = open_raster(block.options, opened.scene)
    with contextlib.ExitStack() as refused:
        if raster is not None:
            refused.callback(raster.context.release)
        if (raster is not None) != block.has_opengl:
            has, lacks = ("has", "lacks") if raster else ("lacks", "has")
            raise BadInputError(
                f"The worker on {platform.node()} {has} OpenGL, and the machine that started the job {lacks} it; "
                "choose --backend cpu, or install libegl1 and libgl1 on all machines."
            )
        return FrameDrawing(block.options, opened, raster), refused.pop_all()
