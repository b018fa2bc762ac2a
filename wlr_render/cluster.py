"""Work spread over the workers of a Dask cluster; the only module that imports Dask. Callers use `processes.py`.

Every worker reads and writes the files of a job at the same paths as the program that started it, as on a cluster with
a shared file system. A task checks this, and the versions of the libraries, before anything of it is unpickled.
"""

import contextlib
import ctypes
import functools
import os
import pickle
import platform
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from wlr_render.errors import BadInputError
from wlr_render.extras import installed_by

if TYPE_CHECKING:
    from distributed import Client, Future

Task = TypeVar("Task")
Result = TypeVar("Result")

is_cluster_worker = False
"""Whether this process is at a task of a job on another machine, whose file locks it may not see."""
_LIBRARIES = ("wlr_render", "numpy", "scipy", "opencv-python-headless", "embreex")
_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
_CONNECT_S = 10.0
_NO_WORKER_S = 120.0
"""Time for which a cluster may have no worker: a queue starts them later, a killed one is started again."""
_POLL_S = 0.02
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3
"""Parameters of mallopt in glibc's malloc.h."""
_KEPT_BYTES = 32 * 1024 * 1024
"""The largest block that glibc keeps by itself (man mallopt: M_MMAP_THRESHOLD)."""
_MARK = ".wlr-part-shared-"
"""Start of the name of the file that workers look for; the next run removes that of a killed one."""


def as_finished_by_cluster(
    run: Callable[[Task], Result], tasks: Sequence[Task], address: str, folder: Path | None
) -> Iterator[Result]:
    """Results of all tasks, in the order in which they are finished; see `processes.as_finished`.

    The tasks of a worker that is lost are given to another one. When the caller stops listening or is interrupted,
    tasks that have not begun are dropped; those at work go on to their end.

    Raises:
        BadInputError: no scheduler answers at the address, there are no workers, a worker has other versions or does
            not see the folder, or a task ended several workers.
        MissingExtraError: Dask is not installed.
    """
    with _client(address) as client, _marked(folder) as mark:
        conditions = {"versions": _versions(), "folder": str(Path.cwd()), "mark": mark}
        payloads = [pickle.dumps((run, task)) for task in tasks]
        futures = client.map(_run_here, payloads, [conditions] * len(payloads), pure=False)
        try:
            for future in _as_completed(client, futures, address):
                yield _result(future, address)
                future.release()
        finally:
            with contextlib.suppress(Exception):  # the scheduler may be gone
                client.cancel(futures)


@contextlib.contextmanager
def _client(address: str) -> "Iterator[Client]":
    with installed_by("dask", f"--scheduler {address}"):
        import dask
        import distributed
    # What goes wrong is said in one sentence; pickled tasks of some megabytes are no fault.
    quiet = {"distributed.admin.large-graph-warning-threshold": "1 GB"}
    with dask.config.set(quiet), _silent_log():
        try:
            client = distributed.Client(address, timeout=_CONNECT_S, set_as_default=False)
        except (OSError, ValueError, TypeError, KeyError, RuntimeError) as error:
            raise BadInputError(
                f"--scheduler {address}: no Dask scheduler answers there ({' '.join(str(error).split())[:200]}); start "
                "one with 'dask scheduler', and give the address that it prints, e.g. tcp://host:8786."
            ) from error
        try:
            yield client
        finally:
            client.close(timeout=_CONNECT_S)


@contextlib.contextmanager
def _silent_log() -> Iterator[None]:
    """Context manager in which Dask, which has loggers that write to the terminal by themselves, writes none."""
    import logging

    loggers = [logging.getLogger(name) for name in ("distributed", "distributed.client", "tornado")]
    before = [logger.disabled for logger in loggers]
    for logger in loggers:
        logger.disabled = True
    try:
        yield
    finally:
        for logger, was_disabled in zip(loggers, before, strict=True):
            logger.disabled = was_disabled


@contextlib.contextmanager
def _marked(folder: Path | None) -> Iterator[str]:
    """Context manager for the path of a file in a folder, "" without a folder."""
    if folder is None:
        yield ""
        return
    try:
        folder.mkdir(parents=True, exist_ok=True)
        mark = tempfile.NamedTemporaryFile(prefix=_MARK, dir=folder.resolve())  # noqa: SIM115  # closed below
    except OSError as error:
        raise BadInputError(f"{folder}: cannot be written ({error.strerror}); choose another folder.") from error
    try:
        yield mark.name
    finally:
        with contextlib.suppress(FileNotFoundError):
            mark.close()


def _versions() -> dict[str, str]:
    """What has to be the same on all machines, so that results do not depend on which of them computes."""
    from importlib import metadata  # a tenth of the time in which the package is imported

    major, minor, _ = platform.python_version_tuple()
    versions = {"Python": f"{major}.{minor}"}
    for name in _LIBRARIES:
        with contextlib.suppress(metadata.PackageNotFoundError):
            versions[name] = metadata.version(name)
    return versions


def _as_completed(client: "Client", futures: "list[Future]", address: str) -> "Iterator[Future]":
    """Futures in the order in which they are finished.

    Raises:
        BadInputError: no worker has been there for long, or the scheduler is gone.
    """
    from distributed import as_completed

    finished = as_completed(futures, loop=client.loop)
    last_seen_s = time.monotonic()
    while not finished.is_empty():
        if finished.has_ready():
            yield next(finished)
            continue
        time.sleep(_POLL_S)
        if client.scheduler_info(n_workers=1)["workers"]:
            last_seen_s = time.monotonic()
        elif time.monotonic() - last_seen_s > _NO_WORKER_S:
            raise BadInputError(
                f"--scheduler {address}: it has had no worker for {_NO_WORKER_S:.0f} s; start some with 'dask worker "
                f"{address} --nthreads 1', and continue."
            )


def _result(future: "Future", address: str) -> Any:
    from distributed import CancelledError, KilledWorker

    try:
        return future.result()
    except KilledWorker as error:
        raise BadInputError(
            f"--scheduler {address}: one task has ended {error.allowed_failures + 1} workers, the last at "
            f"{error.last_worker.address}, perhaps because the memory was full; start fewer workers on a machine or "
            "give them a larger --memory-limit, and continue."
        ) from error
    except CancelledError as error:
        raise BadInputError(
            f"--scheduler {address}: the connection to the scheduler is lost; start it again with its workers, and "
            "continue."
        ) from error
    except (ImportError, RuntimeError) as error:
        is_without_program = (error.name or "").startswith(__package__) if isinstance(error, ImportError) else False
        if is_without_program or "deserializ" in str(error):
            raise _not_loaded(f"--scheduler {address}: the scheduler or a worker", error) from error
        raise


def _not_loaded(who: str, error: Exception) -> BadInputError:
    return BadInputError(
        f"{who} cannot load the program ({' '.join(str(error).split())[:100]}); install the same wlr_render on all "
        "machines, that of the scheduler too, and start what runs benchmarks with PYTHONPATH set to the checkout."
    )


def _run_here(payload: bytes, conditions: dict[str, Any]) -> Any:
    """Run one task in a worker, in the folder that the caller runs in."""
    global is_cluster_worker
    _check_worker(conditions)
    is_cluster_worker = True
    os.environ.setdefault("LP_NUM_THREADS", "1")  # of OpenGL without a GPU, which reads it when a context is opened
    _keep_memory_for_arrays()
    try:
        with contextlib.chdir(conditions["folder"]):
            run, task = _loaded(payload)
            return run(task)
    finally:
        is_cluster_worker = False


def _loaded(payload: bytes) -> Any:
    from distributed import get_worker

    try:
        return pickle.loads(payload)
    except (ImportError, AttributeError) as error:
        raise _not_loaded(f"The worker {get_worker().address}", error) from error


@functools.cache
def _keep_memory_for_arrays() -> None:
    """Let this process keep the memory of an array for the next one, as glibc does by itself.

    Dask starts workers with MALLOC_TRIM_THRESHOLD_, which switches that off: the system then takes back and clears the
    memory of each array, in two fifths of the time of a fit.
    """
    if platform.libc_ver()[0] == "glibc":
        libc = ctypes.CDLL(None)
        libc.mallopt(_M_MMAP_THRESHOLD, _KEPT_BYTES)
        libc.mallopt(_M_TRIM_THRESHOLD, 2 * _KEPT_BYTES)


def _check_worker(conditions: dict[str, Any]) -> None:
    from distributed import get_worker

    worker = get_worker()
    name, own = f"The worker {worker.address}", _versions()
    for library, version in conditions["versions"].items():
        if own.get(library) != version:
            raise BadInputError(
                f"{name} has {library} {own.get(library, 'not')} installed, and this machine {version}; install the "
                "same version on all machines, and start the workers again."
            )
    if worker.state.nthreads > 1:
        raise BadInputError(
            f"{name} has {worker.state.nthreads} threads, and a task needs a process of its own; start workers with "
            "--nworkers auto --nthreads 1."
        )
    if any(os.environ.get(variable) != "1" for variable in _ONE_THREAD):
        raise BadInputError(
            f"{name} calculates with several threads; start it without --no-nanny, or with {'=1 '.join(_ONE_THREAD)}=1."
        )
    for path, kind in ((conditions["folder"], "current folder"), (conditions["mark"], "output folder")):
        if path and not os.path.exists(path):
            shown = path if kind == "current folder" else os.path.dirname(path)
            raise BadInputError(
                f"{name} does not see the {kind} {shown} of this machine; choose one on a file system that all "
                "machines have at the same path."
            )
