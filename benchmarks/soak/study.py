"""A stream of frames: head and eyes move, tracking is lost and regained, and every frame has its own map."""

from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import Annotated

from benchmarks.scene_source import SceneSource
from benchmarks.soak.drawing import draw_frames
from benchmarks.soak.map_check import check_maps, frames_to_check
from benchmarks.soak.picture import draw_stream
from benchmarks.soak.records import Stream
from benchmarks.soak.report import frames_csv, tables_of
from benchmarks.soak.wearer import Wearer
from wlr_render.io.atomic_files import output_folder, write_text
from wlr_render.jobs.headset import headset_path, open_eye
from wlr_render.jobs.options import (
    Backend,
    Eyes,
    Options,
    ProgressArgument,
    Range,
    Seed,
    described,
    described_size,
    eyes_of,
)
from wlr_render.mappings import Eye
from wlr_render.report.blocks import Picture, Report
from wlr_render.report.save import save_report
from wlr_render.scene.scene_file import load_scene
from wlr_render.warp.compositor import Compositor
from wlr_render.work.progress import SILENT, Progress

LATEST_MS = 50.0
"""Largest latency that late correction can compensate."""


@dataclass(frozen=True)
class SoakOptions(Options):
    """Options of `soak`."""

    headset: Annotated[str, described("A device or a model file.")]
    scene: Annotated[str, described("A shipped scene, a scene file or a mesh.")]
    _: KW_ONLY
    head: Annotated[Path | None, described("Head trajectory, TUM or EuRoC (default: synthetic).")] = None
    eye_track: Annotated[
        Path | None, described("Eye trajectory (default: synthetic, with jitter, blinks and dropouts).")
    ] = None
    eye: Annotated[Eyes, described("Eyes to draw.")] = "right"
    frames: Annotated[int, described("Number of frames; the first one warms up."), Range(at_least=2)] = 1000
    frames_per_second: Annotated[float, described("Frames per second.", name="--fps"), Range(above=0)] = 90.0
    size: Annotated[
        tuple[int, int] | None,
        described_size("Width and height of each eye's image (default: the panel's).", optional=True),
        Range(at_least=1),
    ] = None
    late_ms: Annotated[
        float,
        described("Late-warp latency: compose for a head pose this many ms newer than the rendered one."),
        Range(at_least=0, at_most=LATEST_MS),
    ] = 0.0
    seed: Seed = 1
    backend: Backend = "auto"
    out: Annotated[Path, described("Output folder.")] = Path("out/benchmarks/soak")

    @property
    def wearer(self) -> Wearer:
        """Motion of head and eyes."""
        return Wearer(self.head, self.eye_track, self.seed)


def run(options: SoakOptions, *, progress: ProgressArgument = SILENT) -> Report:
    """Draw all frames; write soak.html, .md, .json and .png, and frames.csv.

    Raises:
        BadInputError: faulty files, or trajectories that are too short.
        MissingGlError: OpenGL does not open.
    """
    models: dict[str, Eye] = {eye: open_eye(options.headset, eye) for eye in eyes_of(options.eye)}
    folder = output_folder(options.out)
    stream = draw(options, models, progress)
    rows = write_text(folder / "frames.csv", frames_csv(stream))
    picture = draw_stream(folder / "soak.png", stream)
    inputs = [headset_path(options.headset), *filter(None, (options.head, options.eye_track))]
    width, height = stream.size_px
    report = Report(
        f"{len(stream.frames)} frames of {width} x {height} on {stream.renderer}",
        blocks=[*tables_of(stream), Picture("The stream", picture, "Frame times, viewpoints and memory over time.")],
        inputs=inputs,
        files=[rows, picture],
        record={"options": options, "renderer": stream.renderer, "size_px": stream.size_px},
    )
    return save_report(report, folder, "soak")


def draw(options: SoakOptions, models: Mapping[str, Eye], progress: Progress = SILENT) -> Stream:
    """Draw all frames of some models without writing files.

    Raises:
        BadInputError: see `run`.
    """
    boxes = {eye: each.eye_box for eye, each in models.items()}
    moments = options.wearer.moments(boxes, options.frames, options.frames_per_second, 1e-3 * options.late_ms)
    scene = load_scene(options.scene)
    panel = next(iter(models.values())).display.panel
    size = options.size or (panel.width_px, panel.height_px)
    numbers = frames_to_check(moments)
    with Compositor(models, size, context=options.backend) as compositor:
        source = SceneSource(compositor, scene)
        frames = list(progress(draw_frames(compositor, source, moments), len(moments), "frames"))
        checked = progress(check_maps(compositor, source, moments, numbers), len(numbers), "maps checked")
        checks = [check for of_frame in checked for check in of_frame]
        renderer = compositor.renderer
    return Stream(frames, checks, options.frames_per_second, options.late_ms, renderer, size)
