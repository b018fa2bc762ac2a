"""Work spread over the workers of a Dask cluster; the only module that imports Dask. Callers use `workers.py`.

Every worker reads and writes the files of a job at the same paths as the program that started it, as on a cluster with
a shared file system. A task checks this, and the versions of the libraries, before its data is unpickled.
"""

import contextlib
import ctypes
import functools
import os
import pickle
import platform
import re
import socket
import sys
import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

from wlr_render.errors import BadInputError
from wlr_render.extras import installed_by
from wlr_render.io import atomic_files

LIBRARY_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS") + (
    ("VECLIB_MAXIMUM_THREADS",) if sys.platform == "darwin" else ()
)
"""Environment variables with the number of threads, which a library reads once, when a process loads it."""
OPENGL_THREADS = "LP_NUM_THREADS"
"""Environment variable with the number of threads of OpenGL without a GPU, which reads it when a context is opened."""
_LIBRARIES = (
    "wlr_render",
    "numpy",
    "scipy",
    "opencv-python-headless",
    "embreex",
    "trimesh",
    "moderngl",
    "pyrender-maintained",
    "mitsuba",
    "drjit",
)
_ADDRESS = re.compile(r"(tcp|tls|ws|wss)://(\[[0-9A-Fa-f:.%]+\]|[\w.-]+):([0-9]{1,5})/?")
"""Scheme, host and port of a scheduler."""
_CONNECT_S = 10.0
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3
"""Parameters of mallopt in glibc's malloc.h."""
_KEPT_BYTES = 32 * 1024 * 1024
"""Largest block that glibc keeps by default (man mallopt: M_MMAP_THRESHOLD)."""
_MARK = ".wlr-part-shared-"
"""Prefix of the name of the file that workers look for; the next run removes the file of a killed run."""


Submit = Callable[[Callable[[Any], Any], Any], Future[Any]]
Pool = tuple[Submit, Callable[[], bool]]
"""Function that gives a task to a pool of workers, and a function that returns whether the pool has workers."""


@contextlib.contextmanager
def dask_workers(address: str, folder: Path | None) -> Iterator[Pool]:
    """Connect to the workers of a cluster for a `with` block; waiting tasks are dropped if it ends early.

    Raises:
        BadInputError: no scheduler answers at the address, or an error of `workers.as_finished`.
        MissingExtraError: Dask is not installed.
    """
    with installed_by("dask", f"--scheduler {address}"):
        import distributed
    _require_scheduler(address)
    with _silent_log():
        client = distributed.Client(address, timeout=_CONNECT_S, set_as_default=False)
    try:
        with _marked(folder) as mark, _sentences(address):
            conditions = {"versions": _versions(), "folder": str(Path.cwd()), "mark": mark}
            executor = client.get_executor(pure=False)
            yield (
                lambda run, task: executor.submit(_run_here, pickle.dumps((run, task)), conditions),
                lambda: bool(client.scheduler_info(n_workers=1)["workers"]),
            )
    finally:
        with _silent_log():
            client.close(timeout=_CONNECT_S)  # drops waiting tasks


def _require_scheduler(address: str) -> None:
    """Check that a Dask scheduler answers.

    Dask's client retries for a long time if no server listens, waits forever for a server of another kind, and prints
    a traceback when it gives up.

    Raises:
        BadInputError: the address is malformed, or no scheduler answers there.
    """
    remedy = "start one with 'dask scheduler', and give the address that it prints, e.g. tcp://host:8786"
    parts = _ADDRESS.fullmatch(address)
    if parts is None or not 0 < int(parts[3]) < 1 << 16:
        raise BadInputError(f"--scheduler {address}: is not the address of a Dask scheduler; {remedy}.")
    try:
        with socket.create_connection((parts[2].strip("[]"), int(parts[3])), _CONNECT_S):
            pass
        # In a separate thread: a notebook's thread already has an event loop.
        import asyncio

        with _silent_log(), ThreadPoolExecutor(1) as thread:
            thread.submit(lambda: asyncio.run(_shake_hands(address))).result()
    except (OSError, UnicodeError, ValueError, TypeError, RuntimeError) as error:
        reason = " ".join(str(error).split())[:200] or "another program may listen there"
        raise BadInputError(f"--scheduler {address}: no Dask scheduler answers there ({reason}); {remedy}.") from error


async def _shake_hands(address: str) -> None:
    import asyncio

    from distributed.core import connect
    from distributed.security import Security

    arguments = Security().get_connection_args("client")
    comm = await asyncio.wait_for(connect(address, timeout=_CONNECT_S, **arguments), _CONNECT_S)
    comm.abort()


@contextlib.contextmanager
def _silent_log() -> Iterator[None]:
    """Silence Dask in a `with` block; its loggers write to the terminal."""
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
    """Create a marker file in a folder for a `with` block and give its path; "" without a folder."""
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


@functools.cache
def _versions() -> dict[str, str]:
    """Return the versions that must agree on all machines, so that results do not depend on the machine."""
    from importlib import metadata  # imported here: it takes a tenth of the package's import time

    major, minor, _ = platform.python_version_tuple()
    versions = {"Python": f"{major}.{minor}"}
    for name in _LIBRARIES:
        with contextlib.suppress(metadata.PackageNotFoundError):
            versions[name] = metadata.version(name)
    return versions


@contextlib.contextmanager
def _sentences(address: str) -> Iterator[None]:
    """Convert the errors of a cluster in a `with` block to a `BadInputError` with one sentence."""
    from distributed import KilledWorker

    try:
        yield
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
        is_without_program = (error.name or "").startswith("wlr_render") if isinstance(error, ImportError) else False
        if is_without_program or "deserializ" in str(error):
            raise _not_loaded(f"--scheduler {address}: the scheduler or a worker", error) from error
        raise


def _not_loaded(who: str, error: Exception) -> BadInputError:
    return BadInputError(
        f"{who} cannot load the program ({' '.join(str(error).split())[:100]}); install the same wlr_render on all "
        "machines, including the scheduler's, and start what runs benchmarks with PYTHONPATH set to the checkout."
    )


def _run_here(payload: bytes, conditions: dict[str, Any]) -> Any:
    """Run one task in a worker, in the working directory of the caller."""
    _check_worker(conditions)
    atomic_files.is_cluster_worker = True
    os.environ.setdefault(OPENGL_THREADS, "1")
    _keep_memory_for_arrays()
    try:
        with contextlib.chdir(conditions["folder"]):
            run, task = _loaded(payload)
            return run(task)
    finally:
        atomic_files.is_cluster_worker = False


def _loaded(payload: bytes) -> Any:
    from distributed import get_worker

    try:
        return pickle.loads(payload)
    except (ImportError, AttributeError) as error:
        raise _not_loaded(f"The worker {get_worker().address}", error) from error


@functools.cache
def _keep_memory_for_arrays() -> None:
    """Let this process keep the memory of freed arrays for the next ones, as glibc does by default.

    Dask starts workers with MALLOC_TRIM_THRESHOLD_, which disables that: the system then takes back and clears the
    memory of each array, which takes two fifths of the time of a fit.
    """
    if platform.libc_ver()[0] == "glibc":
        libc = ctypes.CDLL(None)
        libc.mallopt(_M_MMAP_THRESHOLD, _KEPT_BYTES)
        libc.mallopt(_M_TRIM_THRESHOLD, 2 * _KEPT_BYTES)


def _check_worker(conditions: dict[str, Any]) -> None:
    from distributed import get_worker

    worker = get_worker()
    name, installed = f"The worker {worker.address}", _versions()
    for library, version in conditions["versions"].items():
        if installed.get(library) != version:
            raise BadInputError(
                f"{name} has {library} {installed.get(library, 'not')} installed, and this machine {version}; install "
                "the same version on all machines, and start the workers again."
            )
    if worker.state.nthreads > 1:
        raise BadInputError(
            f"{name} has {worker.state.nthreads} threads, and each task needs a separate process; start workers with "
            "--nworkers auto --nthreads 1."
        )
    if any(os.environ.get(variable) != "1" for variable in LIBRARY_THREADS):
        raise BadInputError(
            f"{name} computes with several threads; start it without --no-nanny, or with "
            f"{'=1 '.join(LIBRARY_THREADS)}=1."
        )
    for path, kind in ((conditions["folder"], "current folder"), (conditions["mark"], "output folder")):
        if path and not os.path.exists(path):
            shown = path if kind == "current folder" else os.path.dirname(path)
            raise BadInputError(
                f"{name} does not see the {kind} {shown} of this machine; choose one on a file system that all "
                "machines have at the same path."
            )
