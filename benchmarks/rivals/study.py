"""Published methods and ours on the same captures, simulated or measured by others."""

from dataclasses import KW_ONLY, dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

from benchmarks.rivals.comparison import DEFAULT_METHODS, chosen_methods, compare_methods
from benchmarks.rivals.measured import DataSet, compare_on_measurements
from benchmarks.trial_study import StudyOptions, run_study
from wlr_render.errors import BadInputError
from wlr_render.jobs.options import ProgressArgument, Range, described
from wlr_render.report.blocks import Report
from wlr_render.work.progress import SILENT


@dataclass(frozen=True)
class RivalsOptions(StudyOptions):
    """Options of `rivals`."""

    _: KW_ONLY
    methods: Annotated[
        tuple[str, ...],
        described("Methods to compare: all, or names of docs/methods.md.", flag=True, many=True),
    ] = DEFAULT_METHODS
    repeats: Annotated[
        int | None,
        described("Repetitions of each trial with random errors (default: 3; 10 with --methods all)."),
        Range(at_least=1, at_most=1000),
    ] = None
    measured: Annotated[
        Path | None,
        described(
            "Compare on the measured sets in this folder (docs/measured-data.md) instead; missing ones are left out."
        ),
    ] = None
    sets: Annotated[
        tuple[DataSet, ...] | None,
        described("Measured sets to judge by (default: all that are there).", flag=True, many=True),
    ] = None
    out: Annotated[Path, described("Output folder.")] = Path("out/benchmarks/rivals")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.sets is not None and self.measured is None:
            raise BadInputError("--sets is used with --measured only; leave it out.")


def run(options: RivalsOptions = RivalsOptions(), *, progress: ProgressArgument = SILENT) -> Report:
    """Fit every method to the same captures and judge it by other captures; write rivals.html, .md and .json.

    Raises:
        BadInputError: an unknown method, or see `run_study` and `compare_on_measurements`.
    """
    if options.measured is not None:
        return compare_on_measurements(options.measured, options.sets or (), options.out, progress)
    methods = partial(compare_methods, chosen=chosen_methods(options.methods))
    repeats = options.repeats or (10 if options.methods == ("all",) else 3)
    return run_study("Comparison of methods", options, {"methods": methods}, "rivals", progress, repeats)
