"""Run one command of the program in this process, within limits of memory and of the size of files.

A process for each command would cost more than most commands do; tests/test_signals.py and test_environments.py run
real ones.
"""

import contextlib
import io
import os
import resource
import signal
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from wlr_render import cli

ADDRESS_SPACE = 4 << 30
"""Bytes beyond those in use when the command starts."""
FILE_SIZE = 1 << 30
TRACKER = b"multiprocessing.resource_tracker"
"""The process in which Python counts semaphores; it lives as long as ours."""


@dataclass(frozen=True)
class Outcome:
    """What a command did.

    Attributes:
        status: exit status, or minus the number of the signal that ended it.
        out, err: what it wrote.
        left: whether processes that it started are alive after its end.
        cpu_s: processor time.
        memory_mb: largest resident size.
    """

    status: int
    out: str
    err: str
    left: bool
    cpu_s: float
    memory_mb: float


def run(
    arguments: Sequence[str], folder: Path, environment: Mapping[str, str], printed: Callable[[], tuple[str, str]]
) -> Outcome:
    """Run a command in a folder; `printed` returns what libraries and workers wrote on the file descriptors 1 and 2."""
    processes = _children()
    began_s = _processor_s()
    with _surroundings(folder, environment), limits() as largest_mb, _streams() as (out, err):
        status = cli.main(arguments)
    others = printed()
    return Outcome(
        status,
        _text(out) + others[0],
        _text(err) + others[1],
        bool(_children() - processes),
        _processor_s() - began_s,
        largest_mb(),
    )


@contextlib.contextmanager
def _surroundings(folder: Path, environment: Mapping[str, str]) -> Iterator[None]:
    before, directory = dict(os.environ), os.getcwd()
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    os.environ.update(environment)
    os.chdir(folder)
    try:
        yield
    finally:
        os.chdir(directory)
        os.environ.clear()
        os.environ.update(before)
        assert handlers == {number: signal.getsignal(number) for number in handlers}


@contextlib.contextmanager
def limits() -> Iterator[Callable[[], float]]:
    """Limits of memory and of the size of files; yields a function of the largest growth so far, MB.

    Growth of the resident size: earlier tests have left their share in this process.
    """
    Path("/proc/self/clear_refs").write_text("5")  # the largest size so far is that of now
    began = _sizes()["VmHWM"]
    sizes = {resource.RLIMIT_AS: (_sizes()["VmSize"] << 10) + ADDRESS_SPACE, resource.RLIMIT_FSIZE: FILE_SIZE}
    before = {limit: resource.getrlimit(limit) for limit in sizes}
    for limit, most in sizes.items():
        resource.setrlimit(limit, (most, before[limit][1]))
    try:
        yield lambda: (_sizes()["VmHWM"] - began) / 1024
    finally:
        for limit, pair in before.items():
            resource.setrlimit(limit, pair)


@contextlib.contextmanager
def _streams() -> Iterator[tuple[io.TextIOWrapper, io.TextIOWrapper]]:
    """Standard streams that are files of UTF-8, as where the output goes into a file."""
    out, err = (io.TextIOWrapper(io.BytesIO(), encoding="utf-8") for _ in range(2))
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        yield out, err


def _text(stream: io.TextIOWrapper) -> str:
    stream.flush()
    assert isinstance(stream.buffer, io.BytesIO)
    return stream.buffer.getvalue().decode("utf-8", "replace")


def _children() -> set[int]:
    """Processes that are children of this one, without Python's own."""
    tasks = Path("/proc/self/task").glob("*/children")
    numbers = {int(number) for task in tasks for number in _bytes_of(task).split()}
    return {number for number in numbers if TRACKER not in _bytes_of(Path(f"/proc/{number}/cmdline"))}


def _bytes_of(path: Path) -> bytes:
    """Content of a file of /proc; empty where the thread or process has ended."""
    try:
        return path.read_bytes()
    except OSError:
        return b""


def _processor_s() -> float:
    of_children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + of_children.ru_utime + of_children.ru_stime


def _sizes() -> dict[str, int]:
    """Sizes of this process by their names in /proc, KiB."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return {name: int(value.split()[0]) for name, value in (line.split(":", 1) for line in lines) if "kB" in value}
