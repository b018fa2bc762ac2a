"""Tables of a stream, and a CSV row for each frame."""

import csv
import io
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import fields
from itertools import groupby

import numpy as np

from benchmarks.soak.records import SACCADE_MM, Cost, EyeMoment, FrameNote, MapCheck, Stream
from wlr_render.numerics.arrays import FloatArray
from wlr_render.report.blocks import Cell, ReportTable
from wlr_render.tracking.viewpoint_filter import TrackingState

_PERCENTILES = (50, 95, 99)
_NAMED_DROPS = 5
_COSTS = {
    "whole frame (ms)": "frame_ms",
    "scene drawn (ms)": "draw_ms",
    "maps and warp (ms)": "compose_ms",
    "processor time of all threads (ms)": "cpu_ms",
    "garbage collector (ms)": "collecting_ms",
    "processor taken away by the system (times)": "preempted",
}
_TIMED = ("scene drawn (ms)", "maps and warp (ms)", "whole frame (ms)", "processor time of all threads (ms)")


def tables_of(stream: Stream) -> tuple[ReportTable, ...]:
    """Return the tables in the order of the report."""
    tables = [_times(stream), _slowest(stream), _tracking(stream), _jumps(stream), _rest(stream)]
    return (*tables, _dropped(stream)) if stream.dropped() else tuple(tables)


def costs(frames: Iterable[FrameNote], name: str) -> FloatArray:
    """Return the values (n,) of one attribute of `Cost`."""
    return np.array([getattr(frame.cost, name) for frame in frames], dtype=np.float64)


def gaps(moments: Sequence[EyeMoment]) -> Iterator[slice]:
    """Yield runs of frames without a good sample."""
    for tracked, run in groupby(range(len(moments)), lambda k: moments[k].state == TrackingState.TRACKED):
        numbers = list(run)
        if not tracked:
            yield slice(numbers[0], numbers[-1] + 1)


def _times(stream: Stream) -> ReportTable:
    rows: list[list[Cell]] = []
    timed = stream.frames[1:]
    for name in _TIMED:
        times = costs(timed, _COSTS[name])
        rows.append([name, *(float(x) for x in np.percentile(times, _PERCENTILES)), float(times.max())])
    width, height = stream.size_px
    title = f"{len(stream.frames)} frames of {width} x {height}, {' and '.join(stream.eyes)} eye, by {stream.renderer}"
    period_ms = 1e3 / stream.frames_per_second
    within = int((costs(timed, "frame_ms") <= period_ms).sum())
    notes = [
        f"Without the first frame, which warms up. At {stream.frames_per_second:g} per second a frame has "
        f"{period_ms:.1f} ms; {within} of {len(timed)} took no more."
    ]
    if stream.late_ms:
        notes.append(f"Each frame was drawn for one head pose, and composed for the pose {stream.late_ms:g} ms later.")
    return ReportTable(title, ("stage", *(f"{p} %" for p in _PERCENTILES), "most"), rows, notes)


def _slowest(stream: Stream) -> ReportTable:
    timed = sorted(stream.frames[1:], key=lambda frame: frame.cost.frame_ms)
    cut = len(timed) - max(1, len(timed) // 100)
    rows: list[list[Cell]] = [
        [what, *(float(costs(group, name).mean()) for group in (timed, timed[cut:]))] for what, name in _COSTS.items()
    ]
    rows.append(["viewpoint jumped (%)", *(100 * _share_that_jumped(group) for group in (timed, timed[cut:]))])
    columns = ("mean of", f"all {len(timed)}", f"the slowest {len(timed) - cut}")
    notes = ("Where the slowest take no more processor time than the others, other programs had the processors.",)
    return ReportTable("What the slowest frames have in common", columns, rows, notes)


def _share_that_jumped(frames: Sequence[FrameNote]) -> float:
    return sum(frame.moment.jumped for frame in frames) / len(frames)


def _tracking(stream: Stream) -> ReportTable:
    states = [state.name.lower() for state in TrackingState]
    columns = ("eye", *states, "gaps", "longest (ms)", "farthest fade (mm)", "farthest return (mm)")
    notes = (
        "Frames by how the viewpoint is known: from a sample, held, fading to the last trusted one, or at rest there.",
        "A fade is from the viewpoint held to where it comes to rest; a return is to the first good sample after.",
    )
    rows = [_tracking_row(eye, stream.moments(eye), stream.frames_per_second) for eye in stream.eyes]
    return ReportTable("Blinks and lost tracking", columns, rows, notes)


def _tracking_row(eye: str, moments: Sequence[EyeMoment], frames_per_second: float) -> list[Cell]:
    runs = list(gaps(moments))
    longest = max((run.stop - run.start for run in runs), default=0)
    fades = [1e3 * float(np.linalg.norm(moments[r.stop - 1].viewpoint - moments[r.start].viewpoint)) for r in runs]
    returns = [moments[run.stop].moved_mm for run in runs if run.stop < len(moments)]
    counts: list[Cell] = [sum(moment.state == state for moment in moments) for state in TrackingState]
    ways = [max(fades, default=None), max(returns, default=None)]
    return [eye, *counts, len(runs), 1e3 * longest / frames_per_second, *ways]


def _jumps(stream: Stream) -> ReportTable:
    jumps = stream.jumps()
    whole = sum(not frame.not_converged(eye) for frame, eye in jumps)
    rows = [_check_row(f"{c.time_s:.3f} s, {c.eye} eye", c) for c in stream.checks if c.moved_mm > SACCADE_MM]
    rest = [check for check in stream.checks if check.moved_mm <= SACCADE_MM]
    rows += [_check_row(f"worst of {len(rest)} without a jump", _worst(rest))] if rest else []
    columns = ("frame", "viewpoint moved (mm)", "old map's error (')", "own map's error (')", "points only one has")
    notes = (
        f"Of {len(jumps)} jumps by more than {SACCADE_MM:g} mm, {whole} have every point converged in the same frame; "
        "the farthest are above.",
        "Errors are the largest of any point, in arcminutes, against the exact solve for the frame's viewpoint. The "
        "old map is the previous frame's. For this check, these frames are drawn again after the stream.",
    )
    return ReportTable("Saccades: does the map match the viewpoint of its frame?", columns, rows, notes)


def _check_row(what: str, check: MapCheck) -> list[Cell]:
    return [what, check.moved_mm, check.kept_arcmin, check.own_arcmin, check.one_sided]


def _worst(checks: Sequence[MapCheck]) -> MapCheck:
    return max(checks, key=lambda check: (check.one_sided, check.own_arcmin, check.moved_mm))


def _dropped(stream: Stream) -> ReportTable:
    dropped = sorted(stream.dropped(), key=lambda one: -one[0].not_converged(one[1]))
    rows: list[list[Cell]] = [
        [f"{frame.moment.time_s:.3f} s", eye, frame.not_converged(eye)] for frame, eye in dropped[:_NAMED_DROPS]
    ]
    notes = (f"{len(dropped)} in {len(stream.frames)} frames, the most points first; all are in frames.csv.",)
    return ReportTable("Frames with points that did not converge", ("time", "eye", "points"), rows, notes)


def _rest(stream: Stream) -> ReportTable:
    early, late = stream.resident_mb()
    brought_back = sum(moment.brought_back for eye in stream.eyes for moment in stream.moments(eye))
    head_lost = sum(frame.moment.head_lost for frame in stream.frames)
    at_rest = sum(moment.moved_mm == 0 for eye in stream.eyes for moment in stream.moments(eye)[1:])
    outside = sum("outside fit" in counts for frame in stream.frames for counts in frame.unsolved.values())
    rows: list[list[Cell]] = [
        ["frames with the head's last pose, because its tracker had none", head_lost],
        ["maps kept, because the viewpoint did not change", at_rest],
        ["maps with points that did not converge", len(stream.dropped())],
        ["maps with points outside the model's fitted range", outside],
        ["viewpoints beyond the model's reach, brought back", brought_back],
        ["memory in the second tenth of the frames (MB)", f"{early:.1f}"],
        ["memory in the last tenth (MB)", f"{late:.1f}"],
    ]
    return ReportTable(
        f"In {len(stream.frames)} frames, {len(stream.frames) * len(stream.eyes)} maps", ("what", "value"), rows
    )


def frames_csv(stream: Stream) -> str:
    """Return a CSV table with a row for each frame: time, costs, and the state of each eye."""
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    of_eye = ("tracking", "x_m", "y_m", "z_m", "moved_mm", "brought_back", "not_converged", "otherwise_unsolved")
    names = [each.name for each in fields(Cost)]
    rows.writerow(["time_s", *names, *(f"{eye}_{what}" for eye in stream.eyes for what in of_eye)])
    for frame in stream.frames:
        of_eyes = [cell for eye in stream.eyes for cell in _eye_cells(frame, eye)]
        rows.writerow([frame.moment.time_s, *(getattr(frame.cost, name) for name in names), *of_eyes])
    return text.getvalue()


def _eye_cells(frame: FrameNote, eye: str) -> list[object]:
    at, failed = frame.moment.eyes[eye], frame.not_converged(eye)
    otherwise = sum(frame.unsolved[eye].values()) - failed
    return [at.state.name.lower(), *at.viewpoint.tolist(), at.moved_mm, int(at.brought_back), failed, otherwise]
