"""The CPU cost of a frame: time of submission without drawing, OpenGL calls, and allocations."""

from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from benchmarks.speed.workload import PANEL, bench_model
from benchmarks.submission.measure import WAYS, Submission, measure
from wlr_render.io.atomic_files import output_folder
from wlr_render.jobs.options import Options, ProgressArgument, Range, described
from wlr_render.mappings import Eye
from wlr_render.report.blocks import Cell, Report, ReportTable
from wlr_render.report.save import save_report
from wlr_render.work.progress import SILENT

_COMMON = 12
"""Number of functions that the second table lists."""


@dataclass(frozen=True)
class SubmissionOptions(Options):
    """Options of `submission`."""

    _: KW_ONLY
    frames: Annotated[int, described("Number of frames that are timed."), Range(at_least=2)] = 300
    out: Annotated[Path, described("Output folder.")] = Path("out/benchmarks/submission")


_DEFAULTS = SubmissionOptions()


def run(
    options: SubmissionOptions = _DEFAULTS,
    *,
    progress: ProgressArgument = SILENT,
    models: Annotated[Mapping[str, Eye] | None, Parameter(parse=False)] = None,
) -> Report:
    """Measure, and write submission.html, .md and .json into `options.out`.

    Raises:
        BadInputError: the folder cannot be written, or the processor is not an x86-64.
        MissingGlError: EGL does not open.
    """
    folder = output_folder(options.out)
    if models is None:
        progress.say("fitting the models")
        models = {eye: bench_model(PANEL, eye) for eye in ("left", "right")}
    panel = next(iter(models.values())).display.panel
    size = panel.width_px, panel.height_px
    found = {way: measure(models, size, way, options.frames) for way in progress(WAYS, len(WAYS), "ways")}
    title = f"Submission of {len(models)} eyes of {size[0]} x {size[1]}, without drawing"
    return save_report(Report(title, blocks=[_costs(found), _functions(found)]), folder, "submission")


def _costs(found: Mapping[str, Submission]) -> ReportTable:
    columns = (
        "way",
        "GL calls",
        "of them gets",
        "frame (ms)",
        "begin_frame (ms)",
        "submit (ms)",
        "compose (ms)",
        "peak allocation (KiB)",
        "growth (B/frame)",
    )
    rows: list[list[Cell]] = [
        [
            WAYS[way],
            each.calls,
            each.gets,
            each.frame_ms,
            each.begin_ms,
            each.submit_ms,
            each.compose_ms,
            each.peak_bytes / 1024,
            each.kept_bytes,
        ]
        for way, each in found.items()
    ]
    notes = (
        "Both eyes, from the host's textures into one framebuffer of the host; a new viewpoint every frame.",
        "Times are medians of the thread's CPU time; draws, clears and blits do nothing, all other calls reach the "
        "driver. Calls include ModernGL's. Gets read state: threaded drivers wait for them.",
    )
    return ReportTable("CPU cost of a frame", columns, rows, notes)


def _functions(found: Mapping[str, Submission]) -> ReportTable:
    totals: dict[str, int] = {}
    for each in found.values():
        for name, count in each.by_name.items():
            totals[name] = totals.get(name, 0) + count
    names = sorted(totals, key=lambda name: (-totals[name], name))[:_COMMON]
    rows: list[list[Cell]] = [[name, *(each.by_name.get(name, 0) for each in found.values())] for name in names]
    return ReportTable("The most frequent OpenGL calls of a frame", ("function", *map(str, found)), rows)
