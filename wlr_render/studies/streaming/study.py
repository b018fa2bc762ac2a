"""Draws a stream: head and eyes move, tracking is lost and found again, every frame gets a map of its own."""

import resource
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from wlr_render.compositing.compositor import Compositor
from wlr_render.compositing.scene_source import SceneSource
from wlr_render.errors import BadInputError
from wlr_render.files import output_folder
from wlr_render.mappings import FloatArray
from wlr_render.rendering.scene_file import load_scene
from wlr_render.studies.headset import open_eye
from wlr_render.studies.progress import Progress, silent
from wlr_render.studies.streaming import report
from wlr_render.studies.streaming.records import FrameNote, Stream
from wlr_render.tracking.eye_trajectory_file import read_eye_trajectory
from wlr_render.tracking.head_trajectory_file import read_head_trajectory
from wlr_render.tracking.synthetic import eye_motion, head_motion
from wlr_render.tracking.synthetic_tracker import tracker_samples
from wlr_render.tracking.viewpoint_filter import ViewpointFilter

_STATM = Path("/proc/self/statm")


@dataclass(frozen=True)
class Options:
    """One stream.

    Attributes:
        headset: a device, or a model file per eye.
        scene: a shipped scene, a scene file or a mesh.
        eyes: which eyes to draw.
        head: trajectory file (TUM or EuRoC); None for a made-up wearer.
        eyes_file: eye trajectory file; None for made-up eyes, with saccades, and a tracker that blinks and drops out.
        frames: how many.
        frames_per_second: of the trajectories.
        size: (width, height) of each eye's picture; the panel's own if None.
        context: as `Compositor`.
        solve: as `Compositor`.
        seed: of the made-up wearer.
        out: folder.
    """

    headset: tuple[str, ...]
    scene: str
    eyes: tuple[str, ...] = ("right",)
    head: Path | None = None
    eyes_file: Path | None = None
    frames: int = 1000
    frames_per_second: float = 90.0
    size: tuple[int, int] | None = None
    context: str = "auto"
    solve: str = "auto"
    seed: int = 1
    out: Path = Path("out/stream")


@dataclass(frozen=True)
class _Moment:
    """What trackers say at one moment."""

    time_s: float
    pose: FloatArray
    samples: Mapping[str, FloatArray | None]


def run(options: Options, progress: Progress = silent) -> report.Told:
    """Draw all frames; writes the report into `options.out`.

    Raises:
        BadInputError: faulty files, or trajectories that are too short.
    """
    if len(options.headset) not in (1, len(options.eyes)):
        raise BadInputError(f"{len(options.headset)} headsets for {len(options.eyes)} eyes; give one, or one per eye.")
    specs = options.headset * (len(options.eyes) if len(options.headset) == 1 else 1)
    models = {eye: open_eye(spec, eye) for eye, spec in zip(options.eyes, specs, strict=True)}
    moments = _moments(options, {eye: each.eye_box.centre for eye, each in models.items()})
    scene = load_scene(options.scene)
    folder = output_folder(options.out)
    panel = next(iter(models.values())).display.panel
    size = options.size or (panel.width_px, panel.height_px)
    with Compositor(models, size, context=options.context, solve=options.solve) as compositor:
        filters = {eye: ViewpointFilter(each.eye_box.centre) for eye, each in models.items()}
        source = SceneSource(compositor, scene)
        frames = list(progress(_frames(compositor, source, filters, moments), len(moments), "frames"))
        counts = {eye: each.counts for eye, each in filters.items()}
        stream = Stream(frames, compositor.eyes, counts, compositor.renderer, size)
    return report.write(stream, folder)


def _frames(
    compositor: Compositor, source: SceneSource, filters: Mapping[str, ViewpointFilter], moments: Sequence[_Moment]
) -> Iterator[FrameNote]:
    last: dict[str, FloatArray] = {}
    for moment in moments:
        tracked = {eye: each.update(moment.time_s, moment.samples[eye]) for eye, each in filters.items()}
        viewpoints = {eye: compositor.within_reach(eye, each.viewpoint) for eye, each in tracked.items()}
        start = time.perf_counter()
        for camera in compositor.begin_frame(moment.pose, viewpoints).values():
            source.submit(camera)
        compositor.finish()
        drawn = time.perf_counter()
        composed = compositor.compose()
        compositor.finish()
        done = time.perf_counter()
        yield FrameNote(
            moment.time_s,
            1e3 * (drawn - start),
            1e3 * (done - drawn),
            {eye: each.state for eye, each in tracked.items()},
            {eye: 1e3 * float(np.linalg.norm(at - last.get(eye, at))) for eye, at in viewpoints.items()},
            composed.unsolved(),
            tuple(eye for eye, each in tracked.items() if (each.viewpoint != viewpoints[eye]).any()),
            resident_mb(),
        )
        last = viewpoints


def _moments(options: Options, centres: Mapping[str, FloatArray]) -> list[_Moment]:
    duration_s = options.frames / options.frames_per_second
    head = read_head_trajectory(options.head) if options.head else head_motion(options.seed, duration_s)
    eyes = (
        read_eye_trajectory(options.eyes_file)
        if options.eyes_file
        else eye_motion(dict(centres), options.seed, duration_s)
    )
    spans = [head.time_s, *(eyes.tracks[eye].time_s for eye in options.eyes if eye in eyes.tracks)]
    start, end = max(span[0] for span in spans), min(span[-1] for span in spans)
    time_s = start + np.arange(options.frames) / options.frames_per_second
    if time_s[-1] > end:
        raise BadInputError(
            f"The trajectories cover {end - start:.2f} s, and {options.frames} frames at {options.frames_per_second:g} "
            f"per second take {duration_s:.2f} s; ask for fewer frames, or give longer trajectories."
        )
    if options.eyes_file:
        samples = {eye: list(eyes.viewpoint_at(eye, time_s)) for eye in options.eyes}
    else:
        samples = tracker_samples(eyes, time_s, options.seed)
    poses = head.at(time_s)
    return [_Moment(float(t), poses[k], {eye: samples[eye][k] for eye in options.eyes}) for k, t in enumerate(time_s)]


def resident_mb() -> float:
    """Memory of this process; where the system does not say, its peak so far."""
    if _STATM.exists():
        return int(_STATM.read_text().split()[1]) * resource.getpagesize() / 1e6
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1e6 if sys.platform == "darwin" else 1e3)  # macOS counts bytes, Linux kilobytes
