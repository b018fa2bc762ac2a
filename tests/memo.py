"""Results of slow functions in files, so that all workers of a run of tests compute each of them once."""

import fcntl
import os
import pickle
from collections.abc import Callable
from functools import wraps
from hashlib import sha256
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import cloudpickle
import pytest

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


def shared_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a run's temporary files that all its workers share."""
    base = tmp_path_factory.getbasetemp()
    return base.parent if "PYTEST_XDIST_WORKER" in os.environ else base


def memoised(function: Callable[Arguments, Result], folder: Path) -> Callable[Arguments, Result]:
    """Return the function with its results in files of a folder, by the bytes of the arguments.

    A process that needs a result waits while another one computes it. An error is a result, which is raised in each of
    them. The lock ends with its process: after a killed one, the next process computes.
    """

    @wraps(function)
    def with_memo(*arguments: Arguments.args, **options: Arguments.kwargs) -> Result:
        key = (function.__module__, function.__qualname__, arguments, options)
        path = Path(folder) / f"{sha256(pickle.dumps(key)).hexdigest()}.pickle"
        with open(path.with_suffix(".lock"), "w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not path.exists():
                unfinished = path.with_suffix(".unfinished")
                unfinished.write_bytes(cloudpickle.dumps(_outcome(function, arguments, options)))
                unfinished.rename(path)
        result: Result
        error: Exception | None
        result, error = pickle.loads(path.read_bytes())
        if error is not None:
            raise error
        return result

    return with_memo


def _outcome(function: Callable[..., Result], arguments: Any, options: Any) -> tuple[Result | None, Exception | None]:
    """Return the result and no error, or the reverse."""
    try:
        return function(*arguments, **options), None
    except Exception as error:
        return None, error
