"""Plot of a stream: viewpoint, frame times and memory over time."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from benchmarks.soak.records import EyeMoment, Stream
from benchmarks.soak.report import costs
from wlr_render.io.atomic_files import write_figure
from wlr_render.numerics.arrays import FloatArray
from wlr_render.report.blocks import cell_text
from wlr_render.tracking.viewpoint_filter import TrackingState

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_SHADES = {TrackingState.HELD: "#ffe8a3", TrackingState.FADING: "#f6b26b", TrackingState.LOST: "#e06666"}
_AXIS_COLOURS = {"x (right)": "#1f77b4", "y (up)": "#2ca02c", "z (back)": "#9467bd"}
_STAGES = {"scene": ("draw_ms", "#9ecae1"), "maps and warp": ("compose_ms", "#3182bd")}


def draw_stream(path: Path, stream: Stream) -> Path:
    """Plot one row per eye, the frame times and the memory, over time."""
    from matplotlib.figure import Figure

    heights = [*(1.0 for _ in stream.eyes), 1.2, 0.5]
    figure = Figure(figsize=(12.0, 1.9 * sum(heights) + 0.6), dpi=110, layout="constrained")
    *eye_rows, times, memory = figure.subplots(len(heights), 1, sharex=True, height_ratios=heights)
    time_s = np.array([frame.moment.time_s for frame in stream.frames])
    for row, eye in zip(eye_rows, stream.eyes, strict=True):
        _draw_viewpoint(row, time_s, stream.moments(eye))
        row.set_ylabel(f"{eye} pupil\nmoved (mm)")
    _draw_times(times, time_s, stream)
    _draw_memory(memory, time_s, stream)
    memory.set(xlabel="time (s)", xlim=(time_s[0], time_s[-1]))
    for row in (*eye_rows, times, memory):
        row.spines[["top", "right"]].set_visible(False)
        if row.get_legend_handles_labels()[0]:
            row.legend(loc="upper left", bbox_to_anchor=(1.0, 1.02), fontsize=8, frameon=False)
    width, height = stream.size_px
    figure.suptitle(
        f"{len(stream.frames)} frames of {width} x {height} px for a moving wearer, {stream.renderer}", fontsize=11
    )
    return write_figure(path, figure)


def _draw_viewpoint(row: "Axes", time_s: FloatArray, moments: Sequence[EyeMoment]) -> None:
    """Plot the viewpoint over time, with shading while good samples are missing, and ticks at jumps."""
    viewpoint = np.stack([moment.viewpoint for moment in moments])
    state = np.array([moment.state for moment in moments])
    for (name, colour), mm in zip(_AXIS_COLOURS.items(), 1e3 * (viewpoint - viewpoint[0]).T, strict=True):
        row.plot(time_s, mm, color=colour, linewidth=0.9, label=name)
    # From the frame at which a state begins to the frame at which the next begins.
    until_s = np.append(time_s[1:], 2 * time_s[-1] - time_s[-2])
    for shaded, colour in _SHADES.items():
        for number, k in enumerate(np.flatnonzero(state == shaded)):
            label = shaded.name.lower() if number == 0 else None
            row.axvspan(time_s[k], until_s[k], color=colour, linewidth=0, label=label)
    jumped = time_s[[moment.jumped for moment in moments]]
    bottom = row.get_xaxis_transform()
    row.plot(jumped, np.full(len(jumped), 0.03), "k|", markersize=8, transform=bottom, label="jumped")


def _draw_times(row: "Axes", time_s: FloatArray, stream: Stream) -> None:
    """Plot the stacked stages of every frame after the first, and percentiles of their sum."""
    timed = stream.frames[1:]
    stages = [costs(timed, name) for name, _ in _STAGES.values()]
    row.stackplot(
        time_s[1:], stages, labels=list(_STAGES), colors=[colour for _, colour in _STAGES.values()], linewidth=0
    )
    total = costs(timed, "frame_ms")
    for percent, style in ((50, "-"), (95, "--"), (99, ":")):
        value = float(np.percentile(total, percent))
        row.axhline(value, color="#c0392b", linestyle=style, linewidth=1.0, label=f"{percent} %: {cell_text(value)} ms")
    row.plot(time_s[1:], costs(timed, "cpu_ms"), "k", linewidth=0.6, label="processor time, all threads")
    row.set(ylabel="frame time (ms)", ylim=(0, 1.05 * float(total.max())))


def _draw_memory(row: "Axes", time_s: FloatArray, stream: Stream) -> None:
    resident = costs(stream.frames, "resident_mb")
    early, late = stream.resident_mb()
    told = f"second tenth: {early:.1f} MB\nlast tenth: {late:.1f} MB"
    row.plot(time_s, resident, color="#555555", linewidth=1.2, label=told)
    row.set(ylabel="memory (MB)", ylim=(0, 1.3 * float(resident.max())))
