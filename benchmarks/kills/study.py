"""Kill -9 of jobs at times spread over their duration: the resumed run must give the files of an undisturbed run."""

import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np

from wlr_render.errors import BadInputError
from wlr_render.io.atomic_files import output_folder, write_text
from wlr_render.jobs.frame_plan import METADATA
from wlr_render.jobs.options import Options, ProgressArgument, Range, Seed, described
from wlr_render.report.blocks import Cell, Report, ReportTable
from wlr_render.report.save import save_report
from wlr_render.work.progress import SILENT

JobName = Literal["render", "export", "simulate", "calibrate"]
_LONGEST_END_S = 120.0
"""Longest time in which the processes of a killed run have to end."""
_WAKE_S = 1.0
"""Longest sleep in a wait for a run: Python runs a signal's handler only when the system call that waits returns."""
_SOONER = 0.8
"""Factor on the time of the next kill after a run that ended too early."""
_SESSION = (
    "--viewpoints",
    "3",
    "--camera",
    "640x480",
    "--tracking-camera",
    "800x600",
    "--pattern",
    "gray",
    "--perfect",
)
_FILES = (".png", ".tiff", ".pfm", ".npz", ".toml", ".svg")
_HEAD = "# timestamp tx ty tz qx qy qz qw\n0.0 0 0 0 0 0 0 1\n1.0 0 0 0 0 0.05 0 0.99875\n"


@dataclass(frozen=True)
class KillsOptions(Options):
    """Options of the benchmark."""

    _: KW_ONLY
    jobs: Annotated[tuple[JobName, ...], described("Jobs to kill.", many=True)] = (
        "render",
        "export",
        "simulate",
        "calibrate",
    )
    moments: Annotated[int, described("Kills of each job."), Range(at_least=1, at_most=1000)] = 50
    frames: Annotated[int, described("Frames of the sequence."), Range(at_least=1, at_most=1000)] = 12
    device: Annotated[str, described("Device.")] = "northstar"
    seed: Seed = 1
    out: Annotated[Path, described("Output folder.")] = Path("out/benchmarks/kills")


_DEFAULTS = KillsOptions()


def run(options: KillsOptions = _DEFAULTS, *, progress: ProgressArgument = SILENT) -> Report:
    """Kill, resume and compare; the report lists each difference, leftover process or leftover file as a fault."""
    folder = output_folder(options.out)
    rng = np.random.default_rng(options.seed)
    rows: list[list[Cell]] = []
    faults: list[str] = []
    for name in options.jobs:
        progress.say(f"running {name} undisturbed")
        command = _command(name, options, folder)
        whole = folder / name / "whole"
        shutil.rmtree(whole.parent, ignore_errors=True)
        taken_s = _run(command, whole)
        expected = results(whole)
        began, different = 0, 0
        for number in progress(range(options.moments), options.moments, f"kills of {name}"):
            out = folder / name / f"{number}"
            moment_s = _killed(command, out, taken_s * (number + rng.uniform()) / options.moments)
            began += bool(results(out))
            _run(command, out)
            if found := [*_left(out), *_differences(results(out), expected)]:
                different += 1
                faults.append(f"{name} killed after {moment_s:.3f} s: {found[0]}")
            else:
                shutil.rmtree(out)
        rows.append([name, taken_s, options.moments, began, different])
    table = ReportTable("Kills", ["job", "undisturbed (s)", "killed", "resumed with files", "not the same"], rows)
    verdict = f"{len(faults)} of {options.moments * len(options.jobs)} resumed runs differ from undisturbed ones."
    return save_report(Report("Kills", verdict, blocks=[table], faults=faults), folder, "kills")


def _command(name: JobName, options: KillsOptions, folder: Path) -> list[str]:
    program = [sys.executable, "-m", "wlr_render"]
    if name == "render":
        head = write_text(folder / "head.tum", _HEAD)
        frames = ["--fps", str(options.frames), "--frames", str(options.frames)]
        return [*program, "render", options.device, "dots", "--head", str(head), *frames, "--maps", "tiff", "--out"]
    if name == "export":
        return [*program, "export", options.device, "--format", "pfm", "--pupils", "3", "--out"]
    simulate = [*program, "simulate", options.device, *_SESSION, "--workers", "2", "--out"]
    if name == "simulate":
        return simulate
    session = folder / "session"
    if not session.exists():
        _run(simulate, session)
    return [*program, "calibrate", str(session), "--workers", "2", "--out"]


@contextlib.contextmanager
def _started(command: Sequence[str], out: Path) -> Iterator["subprocess.Popen[bytes]"]:
    """Start a run for a block, and end all its processes afterwards."""
    process = subprocess.Popen(
        [*command, str(out)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, start_new_session=True
    )
    try:
        yield process
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()


def _run(command: Sequence[str], out: Path) -> float:
    """Run to the end; return the seconds that it took."""
    started = time.monotonic()
    with _started(command, out) as process:
        errors = _errors_at_the_end(process)
    if process.returncode != 0:
        raise BadInputError(f"{out}: status {process.returncode}, {errors.decode()[-500:]!r}; correct the cause.")
    return time.monotonic() - started


def _errors_at_the_end(process: "subprocess.Popen[bytes]") -> bytes:
    """Wait for the end of a run, and return its standard error.

    A signal that arrives just before this process sleeps does not wake it, so it wakes periodically.
    """
    while True:
        with contextlib.suppress(subprocess.TimeoutExpired):
            return process.communicate(timeout=_WAKE_S)[1]


def _killed(command: Sequence[str], out: Path, moment_s: float) -> float:
    """Start a run and kill it after some time, or sooner if it ends before; return the time of the kill."""
    while not _kill(command, out, moment_s):
        shutil.rmtree(out)
        moment_s *= _SOONER
    return moment_s


def _kill(command: Sequence[str], out: Path, moment_s: float) -> bool:
    """Kill a run after some time; return whether it was still running. Its workers have to end with it."""
    with _started(command, out) as process:
        time.sleep(moment_s)
        process.kill()
        try:
            process.communicate(timeout=_LONGEST_END_S)  # until the output of its workers ends
        except subprocess.TimeoutExpired as error:
            raise BadInputError(f"{out}: workers outlive their parent, killed after {moment_s:.3f} s.") from error
    return process.returncode == -signal.SIGKILL


def _left(out: Path) -> list[str]:
    """Return leftover hidden files."""
    return [str(path) for path in out.rglob(".*")]


def _differences(found: dict[str, object], expected: dict[str, object]) -> list[str]:
    """Return the names of files that differ, or that only one of the two runs has written."""
    return sorted(name for name in found | expected if name not in found or found[name] != expected.get(name))


def results(out: Path) -> dict[str, object]:
    """Return the content of a job's result files, without data of the run: dates, commands, counts, process times."""
    found: dict[str, object] = {}
    for path in out.rglob("*"):
        name = str(path.relative_to(out))
        if path.name.startswith("."):
            continue
        if path.suffix in _FILES or path.name == METADATA:
            found[name] = path.read_bytes()
        elif path.suffix == ".json":
            content = json.loads(path.read_text(encoding="utf-8"))
            if "outcome" in content:
                found[name] = content["outcome"] | {"seconds": None}
            else:
                found[name] = content["tables"] if "provenance" in content else content
    return found
