"""Draws the frames of a stream as an engine would, and notes what each took."""

import time
from collections.abc import Iterator, Mapping, Sequence

from wlr_render.compositing.composed_frame import ComposedFrame
from wlr_render.compositing.compositor import Compositor
from wlr_render.compositing.scene_source import SceneSource
from wlr_render.mappings import FloatArray
from wlr_render.rendering.scene import Scene
from wlr_render.studies.streaming.map_check import check_maps
from wlr_render.studies.streaming.process import CollectorTime, preemptions, resident_mb
from wlr_render.studies.streaming.records import Cost, FrameNote, MapCheck, Moment

CHECKED = 5
"""So many frames after the largest jumps have their maps checked, and as many without a jump."""


def draw_frames(
    compositor: Compositor, scene: Scene, moments: Sequence[Moment], checks: list[MapCheck]
) -> Iterator[FrameNote]:
    """Draw one frame a moment; between frames, the maps of some are checked, which goes into `checks`."""
    source, checked = SceneSource(compositor, scene), frames_to_check(moments)
    with CollectorTime() as collector:
        for number, moment in enumerate(moments):
            viewpoints = _viewpoints(moment)
            composed, cost = _draw(compositor, source, moment, viewpoints, collector)
            note = FrameNote(moment, cost, composed.unsolved())
            if number in checked:
                checks += check_maps(compositor, composed, moment, _viewpoints(moments[number - 1]))
            yield note


def frames_to_check(moments: Sequence[Moment]) -> set[int]:
    """Numbers of the frames with the farthest jumps, and of as many others, evenly spread; never the first."""
    jumps = [number for number, moment in enumerate(moments) if number and moment.jumped]
    rest = [number for number, moment in enumerate(moments) if number and not moment.jumped]
    jumps.sort(key=lambda number: -max(eye.moved_mm for eye in moments[number].eyes.values()))
    return {*jumps[:CHECKED], *rest[:: -(-len(rest) // CHECKED) or 1]}


def _draw(
    compositor: Compositor,
    source: SceneSource,
    moment: Moment,
    viewpoints: Mapping[str, FloatArray],
    collector: CollectorTime,
) -> tuple[ComposedFrame, Cost]:
    collected_s, preempted, cpu_s = collector.total_s, preemptions(), time.process_time()
    start = time.perf_counter()
    for camera in compositor.begin_frame(moment.world_from_device, viewpoints).values():
        source.submit(camera)
    compositor.finish()
    drawn = time.perf_counter()
    composed = compositor.compose(pose=moment.at_scan_out)
    compositor.finish()
    done = time.perf_counter()
    return composed, Cost(
        draw_ms=1e3 * (drawn - start),
        compose_ms=1e3 * (done - drawn),
        cpu_ms=1e3 * (time.process_time() - cpu_s),
        collecting_ms=1e3 * (collector.total_s - collected_s),
        preempted=preemptions() - preempted,
        resident_mb=resident_mb(),
    )


def _viewpoints(moment: Moment) -> dict[str, FloatArray]:
    return {name: eye.viewpoint for name, eye in moment.eyes.items()}
