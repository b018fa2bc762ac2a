"""What every job of the command line does around its work."""

import functools
import inspect
from collections.abc import Callable
from typing import ParamSpec

from wlr_render.files import locked_folder
from wlr_render.report.blocks import Report

Arguments = ParamSpec("Arguments")


def job(function: Callable[Arguments, Report]) -> Callable[Arguments, Report]:
    """Decorator of a job: no other job writes into its output folder, `options.out`, at the same time.

    Two jobs in one folder would replace each other's files.
    """
    signature = inspect.signature(function)

    @functools.wraps(function)
    def run(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Report:
        bound = signature.bind(*args, **kwargs)
        bound.apply_defaults()
        with locked_folder(bound.arguments["options"].out, function.__name__.replace("_", " ")):
            return function(*args, **kwargs)

    return run
