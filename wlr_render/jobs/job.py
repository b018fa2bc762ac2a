"""What every job of the command line does around its work."""

import functools
import inspect
from collections.abc import Callable
from typing import ParamSpec

from wlr_render.io.atomic_files import locked_folder, output_folder
from wlr_render.io.kept import Kept
from wlr_render.report.blocks import Report
from wlr_render.report.save import save_report

Arguments = ParamSpec("Arguments")

_LISTING = ("render", "export", "simulate", "pattern")
"""Jobs that have a ledger of their files, and refuse a folder of other files themselves."""


def job(function: Callable[Arguments, Report]) -> Callable[Arguments, Report]:
    """Lock a job's output folder, `options.out`, and write the job's report there; a decorator.

    Concurrent jobs in one folder would replace each other's files.
    """
    signature = inspect.signature(function)

    @functools.wraps(function)
    def run(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Report:
        bound = signature.bind(*args, **kwargs)
        bound.apply_defaults()
        out, name = bound.arguments["options"].out, function.__name__.replace("_", "-")
        with locked_folder(out, name):
            if name not in _LISTING:
                Kept(out, {"job": name})  # refuses a folder whose files a ledger lists
            report = function(*args, **kwargs)
            return save_report(report, output_folder(out)) if report.stem else report

    return run
