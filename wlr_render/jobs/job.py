"""The decorator of all jobs: lock the output folder and write the report."""

import functools
import inspect
from collections.abc import Callable
from dataclasses import replace
from typing import ParamSpec

from wlr_render.io.atomic_files import locked_folder, output_folder
from wlr_render.io.kept import Kept
from wlr_render.report.blocks import Report
from wlr_render.report.comparison import read_report
from wlr_render.report.save import save_report

Arguments = ParamSpec("Arguments")

_LISTING = ("render", "export", "simulate", "pattern")
"""Jobs that have a ledger of their files, and refuse a folder of other files themselves."""


def job(function: Callable[Arguments, Report]) -> Callable[Arguments, Report]:
    """Decorate a job: lock its output folder, `options.out`, and write its report there.

    Concurrent jobs in one folder would replace each other's files. The report of `options.against` is read before the
    job starts, because the job may replace it.
    """
    signature = inspect.signature(function)

    @functools.wraps(function)
    def run(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Report:
        bound = signature.bind(*args, **kwargs)
        bound.apply_defaults()
        options, name = bound.arguments["options"], function.__name__.replace("_", "-")
        out = options.out
        with locked_folder(out, name):
            if name not in _LISTING:
                Kept(out, {"job": name})  # refuses a folder whose files a ledger lists
            against = getattr(options, "against", None)
            before = None if against is None else (against, read_report(against, name))
            report = replace(function(*args, **kwargs), verb=name, options=options.recipe_values())
            return save_report(report, output_folder(out), before=before) if report.stem else report

    return run
