"""Results of slow functions in files, so that all workers of a run of tests compute each of them once."""

import os
import pickle
import time
from functools import wraps
from hashlib import sha256
from pathlib import Path

import cloudpickle


def shared_folder(tmp_path_factory):
    """Return the folder of a run's temporary files that all its workers share."""
    base = tmp_path_factory.getbasetemp()
    return base.parent if "PYTEST_XDIST_WORKER" in os.environ else base


def memoised(function, folder, key=lambda *arguments: arguments):
    """Return the function with its results in files of a folder, by the bytes of what `key` returns for the arguments.

    Who asks while another process computes waits; an error is a result, which is raised in each of them.
    """

    @wraps(function)
    def with_memo(*arguments, **options):
        asked = (function.__module__, function.__qualname__, key(*arguments, **options))
        path = Path(folder) / f"{sha256(pickle.dumps(asked)).hexdigest()}.pickle"
        try:
            path.with_suffix(".begun").touch(exist_ok=False)
        except FileExistsError:
            while not path.exists():
                time.sleep(0.1)
        else:
            unfinished = path.with_suffix(".unfinished")
            unfinished.write_bytes(cloudpickle.dumps(_outcome(function, arguments, options)))
            unfinished.rename(path)
        result, error = pickle.loads(path.read_bytes())
        if error is not None:
            raise error
        return result

    return with_memo


def _outcome(function, arguments, options):
    """Return the result and no error, or the reverse."""
    try:
        return function(*arguments, **options), None
    except Exception as error:
        return None, error
