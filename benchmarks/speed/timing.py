"""Times of alternating runs (of the GPU, of the CPU and as a program sees them), and their ratios."""

import ctypes
import math
import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import TypeVar

import moderngl
import numpy as np

from wlr_render.gl import gl
from wlr_render.gl.native_contexts import CurrentContext
from wlr_render.gl.programs import shader_source
from wlr_render.numerics.arrays import FloatArray
from wlr_render.report.blocks import Cell, cell_text

ROUNDS = 15
"""Number of rounds that count; one more, the first, warms up."""
GPU_ROUNDS = 150
"""The same, for frames that take a millisecond."""

Run = Callable[[int], object]
"""Function to be timed; it gets the number of the round, from 0."""

TIME_COLUMNS = "GPU work", "CPU", "as a program sees it"
TIMES_NOTE = (
    "GPU work: from the first command to the end of the last, by time stamps that the GPU writes; the commands wait "
    "behind a pass of some milliseconds, so that the GPU never waits for the program. A software renderer stamps when "
    "its threads are done, and they do wait for the program: there it is the program's time without its first and "
    "last step. CPU: processor time of the calling thread until all is submitted. As a program sees it: until the GPU "
    "is idle."
)
_PLUG_MS, _PLUG_PX = 5.0, 512
"""Shortest time of the pass that keeps the GPU busy, longer than the submission of a frame; side of its target."""
_PLUG = """
#version 410
uniform int rounds;
out vec4 colour;
void main() {
    vec2 z = 0.001 * gl_FragCoord.xy;
    for (int k = 0; k < rounds; ++k)
        z = vec2(z.x * z.x - z.y * z.y, 2.0 * z.x * z.y) * 0.5 + 0.1 * sin(z.yx);
    colour = vec4(z, 0.0, 1.0);
}
"""
_TIMESTAMP, _QUERY_RESULT = 0x8E28, 0x8866

# Standard deviation of a normal distribution over its median absolute deviation, and sqrt(n) times the standard
# deviation of the median of n samples over that of the samples.
_SIGMA_OF_MAD, _OF_MEDIAN = 1.4826, 1.2533


@dataclass(frozen=True, eq=False)
class GpuRun:
    """A run that draws with OpenGL, or works on the CPU alone.

    Attributes:
        run: the function to be timed; it may return before the GPU has finished.
        drawing: opens a block in which the run's OpenGL context is current; None for a run on the CPU alone.
    """

    run: Run
    drawing: Callable[[], AbstractContextManager[moderngl.Context]] | None


@dataclass(frozen=True, eq=False)
class FrameTimes:
    """Times (rounds,) of a `GpuRun`, in milliseconds; see `TIMES_NOTE`. `gpu` is NaN for a run on the CPU alone."""

    gpu: FloatArray
    cpu: FloatArray
    seen: FloatArray

    def cells(self) -> list[Cell]:
        """Return the medians for `TIME_COLUMNS`."""
        medians = (float(np.median(each)) for each in (self.gpu, self.cpu, self.seen))
        return [None if math.isnan(each) else in_ms(each) for each in medians]


def times_ms(*runs: Run, rounds: int = ROUNDS) -> FloatArray:
    """Return the times (rounds, runs) of the runs in milliseconds.

    The runs alternate, so that a busy machine slows them all equally; the first round is dropped.
    """
    return _in_turns(_wall_s, runs, rounds)


def frame_times(*runs: GpuRun, rounds: int = ROUNDS) -> list[FrameTimes]:
    """Time runs that draw; they alternate as in `times_ms`, first as a program sees them, then on the GPU."""
    clocks: dict[moderngl.Context, _GpuClock] = {}

    def gpu_s(each: GpuRun, turn: int) -> float:
        if each.drawing is None:
            return math.nan
        with each.drawing() as context:
            if context not in clocks:
                clocks[context] = _GpuClock(context)
            return clocks[context].seconds(lambda: each.run(turn))

    seen, gpu = _in_turns(_cpu_and_seen_s, runs, rounds), _in_turns(gpu_s, runs, rounds)
    return [FrameTimes(gpu[:, k], *seen[:, k].T) for k in range(len(runs))]


_Each = TypeVar("_Each")


def _in_turns(seconds: Callable[[_Each, int], object], runs: Sequence[_Each], rounds: int) -> FloatArray:
    times = np.array([[seconds(each, turn) for each in runs] for turn in range(rounds + 1)], np.float64)
    return times[1:] * 1e3


def _wall_s(run: Run, turn: int) -> float:
    start = time.perf_counter()
    run(turn)
    return time.perf_counter() - start


def _cpu_and_seen_s(each: GpuRun, turn: int) -> tuple[float, float]:
    start, start_cpu = time.perf_counter(), time.thread_time()
    each.run(turn)
    cpu = time.thread_time() - start_cpu
    if each.drawing is not None:
        with each.drawing() as context:
            context.finish()
    return cpu, time.perf_counter() - start


class _GpuClock:
    """Time stamps of the current OpenGL context, taken after a pass that keeps its GPU busy."""

    def __init__(self, context: moderngl.Context) -> None:
        name, pointer = ctypes.c_uint, ctypes.c_void_p
        function = CurrentContext().function
        self._context, self._names = context, (name * 2)()
        function("glGenQueries", ctypes.c_int, pointer)(2, self._names)
        self._flush, self._stamp = function("glFlush"), function("glQueryCounter", name, name)
        self._result = function("glGetQueryObjectui64v", name, name, pointer)
        program = context.program(vertex_shader=shader_source("full_screen.vert", {}), fragment_shader=_PLUG)
        self._plug = context.vertex_array(program, [])
        self._target = context.framebuffer([context.texture((_PLUG_PX, _PLUG_PX), 4)])
        for rounds in (1 << k for k in range(24)):
            gl.set_uniforms(program, rounds=rounds)
            if self.seconds(self._draw_plug) > _PLUG_MS * 1e-3:
                break

    def _draw_plug(self) -> None:
        self._target.use()
        self._plug.render(vertices=3)

    def seconds(self, job: Callable[[], object]) -> float:
        """Return how many seconds the GPU works on a job."""
        self._draw_plug()
        # A software renderer takes a stamp after it finishes all commands that were flushed together.
        self._flush()
        self._stamp(self._names[0], _TIMESTAMP)
        self._flush()
        job()
        self._stamp(self._names[1], _TIMESTAMP)
        self._context.finish()
        stamps_ns = (ctypes.c_uint64 * 2)()
        for k, query in enumerate(self._names):
            self._result(query, _QUERY_RESULT, ctypes.addressof(stamps_ns) + 8 * k)
        return (stamps_ns[1] - stamps_ns[0]) * 1e-9


def alternately(*runs: Run, rounds: int = ROUNDS) -> list[float]:
    """Return the median time of each run in milliseconds; see `times_ms`."""
    return [float(x) for x in np.median(times_ms(*runs, rounds=rounds), axis=0)]


def in_ms(milliseconds: float) -> str:
    """Format milliseconds for tables."""
    return f"{cell_text(float(milliseconds))} ms"


@dataclass(frozen=True)
class Estimate:
    """A figure computed from times.

    Attributes:
        value: the figure.
        standard_error: its standard error, from the scatter of the times.
    """

    value: float
    standard_error: float

    def __str__(self) -> str:
        return f"{self.value:.2f} +- {self.standard_error:.2f}"


def ratio(first_ms: FloatArray, second_ms: FloatArray) -> Estimate:
    """Return how many times longer the first takes: the median, over the rounds, of the ratio of the times (rounds,).

    The standard error assumes normally distributed ratios and takes their spread from the median absolute deviation, so
    that a single interrupted round has hardly any effect.
    """
    ratios = np.asarray(first_ms, np.float64) / second_ms
    middle = float(np.median(ratios))
    spread = _SIGMA_OF_MAD * float(np.median(np.abs(ratios - middle)))
    return Estimate(middle, _OF_MEDIAN * spread / float(np.sqrt(ratios.size)))
