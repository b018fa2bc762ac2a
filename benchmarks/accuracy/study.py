"""Accuracy of fitted models over random draws, compared with the goals and with the predicted errors."""

from dataclasses import KW_ONLY, dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Literal, get_args

from benchmarks.accuracy.lab_sessions import labs
from benchmarks.accuracy.measurements import (
    camera_positions,
    display,
    prescribed,
    see_through,
    stage,
    stuck,
    time,
    tracking,
)
from benchmarks.trial_study import Experiment, StudyOptions, run_study
from wlr_render.io.atomic_files import write_text
from wlr_render.jobs import limits
from wlr_render.jobs.options import OnlyWith, ProgressArgument, Range, described
from wlr_render.report.blocks import Report
from wlr_render.report.save import markdown
from wlr_render.work.progress import SILENT

PartName = Literal[
    "camera-positions", "display", "see-through", "stage", "tracking", "prescribed", "time", "stuck", "labs"
]


@dataclass(frozen=True)
class AccuracyOptions(StudyOptions):
    """Options of `accuracy`."""

    _: KW_ONLY
    part: Annotated[
        tuple[PartName, ...], described("Measurements to make, one or more (default: all).", flag=True, many=True)
    ] = get_args(PartName)
    counts: Annotated[
        tuple[int, ...],
        described("Numbers of camera positions to compare.", many=True),
        limits.PLACES,
        OnlyWith("part", ("camera-positions",)),
    ] = (5, 9, 12, 16, 25, 36, 49, 81, 121)
    draws: Annotated[int, described("Random draws of each figure."), Range(at_least=1, at_most=1000)] = 10
    stuck: Annotated[
        int,
        described("Random draws among which fits in a wrong maximum are counted."),
        Range(at_least=1, at_most=10_000),
        OnlyWith("part", ("stuck",)),
    ] = 100
    sessions: Annotated[
        int,
        described("Sessions of labs of each kind."),
        Range(at_least=1, at_most=1000),
        OnlyWith("part", ("labs",)),
    ] = 2
    record: Annotated[Path | None, described("Folder in which accuracy.md is kept, too.")] = None
    out: Annotated[Path, described("Output folder.")] = Path("out/benchmarks/accuracy")


def run(options: AccuracyOptions = AccuracyOptions(), *, progress: ProgressArgument = SILENT) -> Report:
    """Measure; write accuracy.html, .md and .json.

    Raises:
        BadInputError: see `run_study`.
    """
    measurements: dict[PartName, Experiment] = {
        "camera-positions": partial(camera_positions, counts=sorted(set(options.counts))),
        "display": display,
        "see-through": see_through,
        "stage": stage,
        "tracking": tracking,
        "prescribed": prescribed,
        "time": time,
        "labs": partial(labs, sessions=options.sessions),
        "stuck": partial(stuck, draws=options.stuck),
    }
    chosen = {str(part): measurements[part] for part in options.part}
    report = run_study("Accuracy of fits", options, chosen, "accuracy", progress, options.draws)
    if options.record is not None:
        write_text(options.record / "accuracy.md", markdown(report, options.record))
    return report
