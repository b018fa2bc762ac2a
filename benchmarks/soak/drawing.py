"""Draw the frames of a stream as an engine would, and record the time of each frame."""

import time
from collections.abc import Iterator, Sequence

from benchmarks.scene_source import SceneSource
from benchmarks.soak.process import CollectorTime, preemptions, resident_mb
from benchmarks.soak.records import Cost, FrameNote, StreamFrame
from wlr_render.warp.composed_frame import ComposedFrame
from wlr_render.warp.compositor import Compositor


def draw_frames(compositor: Compositor, source: SceneSource, moments: Sequence[StreamFrame]) -> Iterator[FrameNote]:
    """Draw one frame for each moment."""
    with CollectorTime() as collector:
        for moment in moments:
            composed, cost = _draw(compositor, source, moment, collector)
            yield FrameNote(moment, cost, composed.unsolved())


def _draw(
    compositor: Compositor, source: SceneSource, moment: StreamFrame, collector: CollectorTime
) -> tuple[ComposedFrame, Cost]:
    collected_s, preempted, cpu_s = collector.total_s, preemptions(), time.process_time()
    start = time.perf_counter()
    for camera in compositor.begin_frame(moment.world_from_device, moment.viewpoints).values():
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
