"""Run commands fast: one process imports the heavy modules once, and forks a child for each command.

A child differs from a fresh program in nothing but the modules that it finds imported.
"""

import json
import os
import resource
import runpy
import signal
import subprocess
import sys
import time
import traceback
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

MODULES = (
    *("numpy", "cv2", "trimesh", "moderngl", "glcontext", "matplotlib.figure", "PIL.Image"),
    *("scipy.optimize", "scipy.interpolate", "scipy.spatial", "scipy.ndimage"),
    *("rich.progress", "rich.status", "rich.table"),
)
ADDRESS_SPACE = 6 << 30
FILE_SIZE = 1 << 30
SECONDS = float(os.environ.get("CORPUS_SECONDS", "60"))
"""A command that has not ended by then hangs."""


@dataclass(frozen=True)
class Outcome:
    """What a command did.

    Attributes:
        status: its exit status, or minus the number of the signal that ended it.
        out, err: what it wrote.
        hung: it was killed since it did not end.
        left: processes of its session were alive after its end.
        cpu_s: processor time.
        memory_mb: largest resident size.
    """

    status: int
    out: str
    err: str
    hung: bool
    left: bool
    cpu_s: float
    memory_mb: float


class Zygote:
    """The process that forks; `run` is answered when its child has ended."""

    def __init__(self) -> None:
        environment = os.environ | {"OPENBLAS_NUM_THREADS": "1", "MPLBACKEND": "agg"}
        self._process = subprocess.Popen(
            [sys.executable, __file__], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment
        )

    def run(self, arguments: Sequence[str], folder: Path, streams: Path, environment: Mapping[str, str]) -> Outcome:
        """Run one command in a folder; its output goes to `streams`.out and `streams`.err."""
        assert self._process.stdin
        assert self._process.stdout
        request = {"arguments": list(arguments), "folder": str(folder), "streams": str(streams)}
        self._process.stdin.write(json.dumps(request | {"environment": dict(environment)}) + "\n")
        self._process.stdin.flush()
        return Outcome(**json.loads(self._process.stdout.readline()))

    def close(self) -> None:
        """End the process."""
        assert self._process.stdin
        self._process.stdin.close()
        self._process.wait()


def serve() -> None:
    """Answer requests from standard input on standard output."""
    for name in MODULES:
        __import__(name)
    import_verbs()
    requests = os.fdopen(os.dup(0), encoding="utf-8")
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    for line in requests:
        answers.write(json.dumps(asdict(_outcome(json.loads(line)))) + "\n")
        answers.flush()


def import_verbs() -> None:
    """Import the jobs' modules, as the command line does for the verb in use."""
    import importlib

    from wlr_render.cli import VERBS

    for verb in VERBS:
        importlib.import_module(f"wlr_render.jobs.{verb.function.split(':')[0]}")


def _outcome(request: dict) -> Outcome:
    child = os.fork()
    if child == 0:
        _be_the_program(request)
    ended, status, used, hung = 0, 0, None, False
    end = time.monotonic() + SECONDS
    while not ended:
        ended, status, used = os.wait4(child, 0 if hung else os.WNOHANG)
        if not ended and time.monotonic() > end:
            hung = True
            os.killpg(child, signal.SIGKILL)
        elif not ended:
            time.sleep(0.005)
    left = _end_others(child)
    out, err = (Path(f"{request['streams']}.{name}").read_bytes().decode("utf-8", "replace") for name in ("out", "err"))
    cpu_s = used.ru_utime + used.ru_stime
    return Outcome(os.waitstatus_to_exitcode(status), out, err, hung, left, cpu_s, used.ru_maxrss / 1024)


def _end_others(session: int) -> bool:
    """Whether the session of a child that ended has processes left; they are killed."""
    end = time.monotonic() + 5.0
    try:
        while time.monotonic() < end:
            os.killpg(session, 0)
            time.sleep(0.02)
        os.killpg(session, signal.SIGKILL)
    except ProcessLookupError:
        return False
    return True


def _be_the_program(request: dict) -> None:
    """Run the command in this process, a fork, and end it."""
    os.setsid()
    os.chdir(request["folder"])
    os.environ.update(request["environment"])
    for limit, most in (
        (resource.RLIMIT_AS, ADDRESS_SPACE),
        (resource.RLIMIT_FSIZE, FILE_SIZE),
        (resource.RLIMIT_CORE, 0),
    ):
        resource.setrlimit(limit, (most, most))
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    create = os.O_WRONLY | os.O_CREAT | os.O_TRUNC
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.dup2(os.open(f"{request['streams']}.out", create), 1)
    os.dup2(os.open(f"{request['streams']}.err", create), 2)
    os.closerange(3, 256)
    sys.stdout, sys.stderr = os.fdopen(1, "w", encoding="utf-8"), os.fdopen(2, "w", encoding="utf-8")
    sys.argv = ["wlr-render", *request["arguments"]]
    status = 1
    try:
        runpy.run_module("wlr_render", run_name="__main__")
    except SystemExit as end:
        status = end.code if isinstance(end.code, int) else int(end.code is not None)
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)


if __name__ == "__main__":
    serve()
