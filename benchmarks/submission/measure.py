"""A host program for each way of using a compositor; the OpenGL calls and the time of its frames, without drawing."""

import contextlib
import gc
import statistics
import time
import tracemalloc
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import moderngl
import numpy as np

from benchmarks.submission.gl_calls import GlCalls, is_get
from wlr_render.gl import gl
from wlr_render.mappings import Eye
from wlr_render.warp.compositor import Compositor
from wlr_render.warp.stored_picture import DepthKind, StoredDepth

WAYS = {
    "own": "own context",
    "computed": "own context, compute shaders also on a software renderer",
    "shared": "context that shares with the host's, each call switches to it",
    "block": "context that shares with the host's, one switch a frame",
    "clean": "the context of a clean host",
}
"""Ways of using a compositor, and their names in the table."""

_WARM_UP = 5
_STORED = StoredDepth(DepthKind.WINDOW, 0.05, np.inf)


@dataclass(frozen=True)
class Submission:
    """CPU cost of a frame of all eyes without drawing.

    Attributes:
        calls, gets: OpenGL calls of one frame, and the number of these that read state.
        begin_ms, submit_ms, compose_ms, frame_ms: medians of the CPU time of this thread.
        peak_bytes: memory that Python allocates at the peak of a frame, median over the frames.
        kept_bytes: growth of the memory that Python keeps, per frame.
        by_name: number of calls of each function in one frame.
    """

    calls: int
    gets: int
    begin_ms: float
    submit_ms: float
    compose_ms: float
    frame_ms: float
    peak_bytes: float
    kept_bytes: float
    by_name: Mapping[str, int]


class Host:
    """A program that draws both eyes into its own textures and composes into a framebuffer of twice the width."""

    def __init__(self, models: Mapping[str, Eye], size: tuple[int, int], way: str) -> None:
        settings: Any = {"standalone": True, "require": 410, "backend": "egl"}
        self._caller = None if way in ("own", "computed") else moderngl.create_context(**settings)
        self._own = gl.open_context("egl") if self._caller is None else None
        if self._own is not None and way == "computed":
            self._own.computes, self._own.dispatches.eyes = True, 2
        host_state: Any = "clean" if way == "clean" else "kept"
        self.compositor = Compositor(models, size, context=self._own or self._caller, host_state=host_state)
        self._models, self._in_block = models, way == "block"
        with self._working():
            ctx = self._caller or vars(self.compositor.context)["_ctx"]
            cameras = {eye: self.compositor.plan(eye).camera for eye in models}
            self._drawn = {
                eye: ctx.framebuffer([ctx.texture(camera.size_px, 4)], ctx.depth_texture(camera.size_px))
                for eye, camera in cameras.items()
            }
            self._screen = ctx.simple_framebuffer((len(models) * size[0], size[1]))

    def frame(self, number: int) -> list[float]:
        """Run a frame; return this thread's CPU times, in seconds, at its start and after each of three steps."""
        unit = np.array([0.3 * np.sin(0.1 * number), 0.2 * np.cos(0.07 * number), 0.0])
        viewpoints = {eye: mappings.eye_box.at(unit) for eye, mappings in self._models.items()}
        pose, late = np.eye(4), np.eye(4)
        late[:3, 3] = 1e-3 * unit
        times = [time.thread_time()]
        self.compositor.begin_frame(pose, viewpoints)
        times.append(time.thread_time())
        with self.compositor.context.drawing() if self._in_block else contextlib.nullcontext():
            self.compositor.submit(self._drawn, stored=_STORED)
            times.append(time.thread_time())
            self.compositor.compose(self._screen, pose=late)
        return [*times, time.thread_time()]

    def release(self) -> None:
        """Free the compositor and the host's context."""
        self.compositor.release()
        for context in (self._own, self._caller):
            if context is not None:
                context.release()

    def _working(self) -> contextlib.AbstractContextManager[object]:
        return self.compositor.context.drawing() if self._caller is None else contextlib.nullcontext()


def measure(models: Mapping[str, Eye], size: tuple[int, int], way: str, frames: int) -> Submission:
    """Measure one of `WAYS` over `frames` frames; `size` is the (width, height) of one eye's display.

    Raises:
        BadInputError: the processor is not an x86-64; see also `Compositor`.
        MissingGlError: EGL is not available.
    """
    calls = GlCalls()
    with calls.counted():
        host = Host(models, size, way)
        try:
            for number in range(_WARM_UP):
                host.frame(number)
            with calls.without_drawing():
                calls.start()
                host.frame(_WARM_UP)
                by_name = calls.found()
                times = np.array([host.frame(number) for number in range(frames)])
                peaks, kept = _allocations(host, frames)
        finally:
            host.release()
    begin, submit, compose = 1e3 * np.median(np.diff(times, axis=1), axis=0)
    frame = 1e3 * float(np.median(times[:, -1] - times[:, 0]))
    gets = sum(count for name, count in by_name.items() if is_get(name))
    numbers = float(begin), float(submit), float(compose), frame, peaks, kept
    return Submission(sum(by_name.values()), gets, *numbers, by_name)


def _allocations(host: Host, frames: int) -> tuple[float, float]:
    """Return the median over frames of the peak above the frame's start, and the growth per frame, in bytes."""
    peaks = []
    tracemalloc.start()
    try:
        for number in range(_WARM_UP):  # the compositor keeps the last frames
            host.frame(number)
        gc.collect()
        first, _ = tracemalloc.get_traced_memory()
        for number in range(frames):
            before, _ = tracemalloc.get_traced_memory()
            tracemalloc.reset_peak()
            host.frame(number)
            peaks.append(tracemalloc.get_traced_memory()[1] - before)
        gc.collect()
        last, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    return float(statistics.median(peaks)), (last - first) / frames
