"""Results of slow functions in files, so that all workers of a run of tests compute each of them once."""

import fcntl
import os
import pickle
from functools import wraps
from hashlib import sha256
from pathlib import Path

import cloudpickle


def shared_folder(tmp_path_factory):
    """Return the folder of a run's temporary files that all its workers share."""
    base = tmp_path_factory.getbasetemp()
    return base.parent if "PYTEST_XDIST_WORKER" in os.environ else base


def memoised(function, folder):
    """Return the function with its results in files of a folder, by the bytes of the arguments.

    A process that needs a result waits while another one computes it. An error is a result, which is raised in each of
    them. The lock ends with its process: after a killed one, the next process computes.
    """

    @wraps(function)
    def with_memo(*arguments, **options):
        key = (function.__module__, function.__qualname__, arguments, options)
        path = Path(folder) / f"{sha256(pickle.dumps(key)).hexdigest()}.pickle"
        with open(path.with_suffix(".lock"), "w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not path.exists():
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
