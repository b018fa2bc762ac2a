"""What every job of the command line does around its work."""

import functools
import inspect
from collections.abc import Callable
from pathlib import Path
from typing import ParamSpec

from wlr_render.errors import BadInputError
from wlr_render.io.atomic_files import locked_folder
from wlr_render.io.finished_files import LIST
from wlr_render.report.blocks import Report

Arguments = ParamSpec("Arguments")

_LISTING = ("render", "export", "simulate", "pattern")
"""Jobs that list the files of their folder, and refuse a folder of other files themselves."""


def job(function: Callable[Arguments, Report]) -> Callable[Arguments, Report]:
    """Lock a job's output folder, `options.out`, against other jobs; a decorator.

    Concurrent jobs in one folder would replace each other's files.
    """
    signature = inspect.signature(function)

    @functools.wraps(function)
    def run(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Report:
        bound = signature.bind(*args, **kwargs)
        bound.apply_defaults()
        out, name = bound.arguments["options"].out, function.__name__
        if name not in _LISTING:
            require_unlisted(out)
        with locked_folder(out, name.replace("_", "-")):
            return function(*args, **kwargs)

    return run


def require_unlisted(folder: Path) -> None:
    """Refuse a folder whose files another job lists.

    Raises:
        BadInputError: the folder has a list of finished files.
    """
    if (folder / LIST).exists():
        raise BadInputError(f"{folder}: holds the files of another job, which {LIST} lists; choose another folder.")
