"""A stream: head and eyes move, tracking is lost and found again, and every frame gets a map of its own."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from benchmarks.soak import report
from benchmarks.soak.drawing import draw_frames
from benchmarks.soak.map_check import check_maps, frames_to_check
from benchmarks.soak.picture import draw_stream
from benchmarks.soak.records import Stream
from benchmarks.soak.wearer import Wearer
from wlr_render.compositing.compositor import Compositor
from wlr_render.compositing.scene_source import SceneSource
from wlr_render.errors import BadInputError
from wlr_render.files import output_folder
from wlr_render.jobs.headset import open_eye
from wlr_render.mappings import EyeMappings
from wlr_render.progress import SILENT, Progress
from wlr_render.rendering.scene_file import load_scene
from wlr_render.report.blocks import ReportTable

LATEST_MS = 50.0
"""A pose older than this is beyond what late correction can make good."""


@dataclass(frozen=True)
class Options:
    """One stream.

    Attributes:
        headset: a device, or a model file per eye.
        scene: a shipped scene, a scene file or a mesh.
        eyes: which eyes to draw.
        wearer: trajectories, or a made-up wearer.
        frames: how many; the first one warms up.
        frames_per_second: of the trajectories.
        late_ms: how long after a frame has begun its newest head pose is taken, for late correction.
        size: (width, height) of each eye's picture; the first panel's own if None.
        context: as `Compositor`.
        solve: as `Compositor`.
        out: folder.
    """

    headset: tuple[str, ...]
    scene: str
    eyes: tuple[str, ...] = ("right",)
    wearer: Wearer = field(default_factory=Wearer)
    frames: int = 1000
    frames_per_second: float = 90.0
    late_ms: float = 0.0
    size: tuple[int, int] | None = None
    context: str = "auto"
    solve: str = "auto"
    out: Path = Path("out/benchmarks/soak")


@dataclass(frozen=True)
class Result:
    """Tables in the order of telling, and the files written."""

    tables: tuple[ReportTable, ...]
    files: tuple[Path, ...]


def run(options: Options, progress: Progress = SILENT) -> Result:
    """Draw all frames; writes soak.md, soak.json, frames.csv and soak.png.

    Raises:
        BadInputError: options that make no sense, faulty files, or trajectories that are too short.
        MissingGlError: OpenGL was asked for by name, and does not open.
    """
    _require_sense(options)
    specs = options.headset * (len(options.eyes) if len(options.headset) == 1 else 1)
    models = {eye: open_eye(spec, eye) for eye, spec in zip(options.eyes, specs, strict=True)}
    folder = output_folder(options.out)
    stream = draw(options, models, progress)
    tables = report.tables_of(stream)
    return Result(tables, (*report.write(stream, tables, folder), draw_stream(folder / "soak.png", stream)))


def draw(options: Options, models: Mapping[str, EyeMappings], progress: Progress = SILENT) -> Stream:
    """Draw all frames of some models, and write nothing.

    Raises:
        BadInputError: as `run`.
    """
    boxes = {eye: each.eye_box for eye, each in models.items()}
    moments = options.wearer.moments(boxes, options.frames, options.frames_per_second, 1e-3 * options.late_ms)
    scene = load_scene(options.scene)
    panel = next(iter(models.values())).display.panel
    size = options.size or (panel.width_px, panel.height_px)
    numbers = frames_to_check(moments)
    with Compositor(models, size, context=options.context, solve=options.solve) as compositor:
        source = SceneSource(compositor, scene)
        frames = list(progress(draw_frames(compositor, source, moments), len(moments), "frames"))
        checked = progress(check_maps(compositor, source, moments, numbers), len(numbers), "maps checked")
        checks = [check for of_frame in checked for check in of_frame]
        renderer = compositor.renderer
    return Stream(frames, checks, options.frames_per_second, options.late_ms, renderer, size)


def _require_sense(options: Options) -> None:
    if len(options.headset) not in (1, len(options.eyes)):
        raise BadInputError(
            f"{len(options.headset)} headsets are given for {len(options.eyes)} eyes; give one device, or one model "
            "file per eye in the order of the eyes."
        )
    if options.frames < 2:
        raise BadInputError("A stream of 1 frame has no frame times, because the first warms up; ask for 2 or more.")
    if not 0 < options.frames_per_second < np.inf:
        raise BadInputError(f"The frame rate is {options.frames_per_second}; it must be positive and finite.")
    if not 0 <= options.late_ms <= LATEST_MS:
        raise BadInputError(f"The late correction is by {options.late_ms:g} ms; give 0 to {LATEST_MS:g} ms.")
