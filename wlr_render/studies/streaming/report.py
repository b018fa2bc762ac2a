"""A stream told: a table, a record of every frame, a picture of the frame times."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from wlr_render.evaluation.report import Cell, ReportTable
from wlr_render.files import write_text, written_whole
from wlr_render.studies.streaming.records import SACCADE_MM, Stream
from wlr_render.tracking.tracked_viewpoint import TrackingState

_PARTS = {"draw_ms": "scene drawn (ms)", "compose_ms": "maps and warp (ms)", "frame_ms": "whole frame (ms)"}
_PERCENTILES = (50, 95, 99)
_SHADES = {TrackingState.HELD: "#ffd966", TrackingState.FADING: "#f6b26b", TrackingState.LOST: "#cc4125"}


@dataclass(frozen=True)
class Told:
    """What a stream came to, and the files that say so."""

    tables: tuple[ReportTable, ...]
    picture: Path
    files: tuple[Path, ...]


def write(stream: Stream, folder: Path) -> Told:
    """Write stream.md, stream.json and stream.png."""
    tables = (_times(stream), _events(stream))
    write_text(folder / "stream.md", "\n".join(table.markdown() for table in tables))
    write_text(folder / "stream.json", json.dumps(_record(stream), indent=1) + "\n")
    picture = _draw(stream, folder / "stream.png")
    return Told(tables, picture, (folder / "stream.md", folder / "stream.json", picture))


def _times(stream: Stream) -> ReportTable:
    rows: list[list[Cell]] = []
    for part, name in _PARTS.items():
        times = stream.times_ms(part)
        rows.append([name, *(float(x) for x in np.percentile(times, _PERCENTILES)), float(times.max())])
    width, height = stream.size_px
    title = f"{len(stream.frames)} frames of {width} x {height}, {' and '.join(stream.eyes)} eye, by {stream.renderer}"
    return ReportTable(title, ("stage", *(f"{p} %" for p in _PERCENTILES), "most"), rows, ("Without the first frame.",))


def _events(stream: Stream) -> ReportTable:
    rows: list[list[Cell]] = [[f"{eye} eye's tracker", stream.counts[eye].sentence] for eye in stream.eyes]
    rows += [
        [f"jumps of a viewpoint by more than {SACCADE_MM:g} mm", _jumps(stream)],
        ["frames with points that did not converge", _dropped(stream)],
        ["viewpoints beyond the models' reach, brought back", sum(len(frame.brought_back) for frame in stream.frames)],
        ["memory at the end, against the second tenth", f"{stream.memory_growth_mb():+.1f} MB"],
    ]
    return ReportTable("What happened", ("event", "how often"), rows)


def _jumps(stream: Stream) -> str:
    jumps = stream.jumps()
    unsettled = sum(frame.not_converged(eye) > 0 for frame, eye in jumps)
    return f"{len(jumps)}, of which {len(jumps) - unsettled} solved everywhere in the same frame"


def _dropped(stream: Stream) -> str:
    dropped = stream.dropped()
    if not dropped:
        return "none"
    most = max(frame.not_converged(eye) for frame, eye in dropped)
    first, eye = dropped[0]
    return f"{len(dropped)}, up to {most} points; the first at {first.time_s:.3f} s, {eye} eye"


def _record(stream: Stream) -> dict[str, object]:
    frames = [
        {
            "time_s": frame.time_s,
            "draw_ms": frame.draw_ms,
            "compose_ms": frame.compose_ms,
            "tracking": {eye: state.name.lower() for eye, state in frame.states.items()},
            "moved_mm": dict(frame.moved_mm),
            "unsolved": {eye: dict(counts) for eye, counts in frame.unsolved.items()},
            "brought_back": list(frame.brought_back),
            "resident_mb": frame.resident_mb,
        }
        for frame in stream.frames
    ]
    return {"renderer": stream.renderer, "size_px": list(stream.size_px), "frames": frames}


def _draw(stream: Stream, path: Path) -> Path:
    """Frame times over time; where no eye sample was good is shaded, jumps are ticks."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 4), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    shown = stream.frames[1:]
    time_s = np.array([frame.time_s for frame in shown])
    for part, name in _PARTS.items():
        axes.plot(time_s, stream.times_ms(part), linewidth=0.8, label=name)
    worst = np.array([max(frame.states.values()) for frame in shown])
    for state, colour in _SHADES.items():
        axes.fill_between(
            time_s,
            0,
            1,
            where=worst == state,
            transform=axes.get_xaxis_transform(),
            color=colour,
            alpha=0.5,
            linewidth=0,
            step="mid",
            label=f"viewpoint {state.name.lower()}",
        )
    jumped = [frame.time_s for frame, _ in stream.jumps()]
    axes.plot(jumped, np.full(len(jumped), 0.02), "k|", transform=axes.get_xaxis_transform(), label="viewpoint jumped")
    axes.set(
        xlabel="time (s)",
        ylabel="ms",
        ylim=(0, None),
        title=f"{stream.renderer}, {stream.size_px[0]} x {stream.size_px[1]}",
    )
    figure.legend(fontsize="small", loc="outside right upper")
    with written_whole(path) as temporary:
        figure.savefig(temporary, dpi=110)
    return path
