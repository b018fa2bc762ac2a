"""Provenance of a result: date, version, command line, options and inputs."""

import datetime
import hashlib
import shlex
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from wlr_render import __version__
from wlr_render.io.input_files import LIMITS
from wlr_render.report.blocks import Report


@dataclass(frozen=True)
class InputFile:
    """An input of a result: its name and the SHA-256 of its content.

    The hash of a folder covers the sorted list of its files' relative names and hashes, without files of an output
    folder inside it. For an input that can no longer be read, or that is too large for any reader, the reason replaces
    the hash.
    """

    name: str
    sha256: str


@dataclass(frozen=True)
class Provenance:
    """Date, version, command line, verb, options and inputs of a result."""

    date: str
    version: str
    command: str
    verb: str
    options: Mapping[str, Any]
    inputs: tuple[InputFile, ...]


def provenance(report: Report, output: Path) -> Provenance:
    """Return the provenance of a report of the running program, which writes to folder `output`."""
    now = datetime.datetime.now().astimezone().isoformat(timespec="seconds")
    hashes = (_sha256(path, output) for path in report.inputs)
    inputs = tuple(map(InputFile, map(str, report.inputs), hashes))
    return Provenance(now, __version__, _command(), report.verb, report.options, inputs)


def _command() -> str:
    """Return the command line, or words for a notebook or a prompt, where it does not describe the job."""
    started, arguments = Path(sys.argv[0]), sys.argv[1:]
    if started.stem == "ipykernel_launcher" or started.name in ("", "-c"):
        return "Python, without a command line"
    program = ["python", "-m", started.parent.name] if started.name == "__main__.py" else [started.name]
    return shlex.join([*program, *arguments])


def _sha256(path: Path, output: Path) -> str:
    try:
        if not path.is_dir():
            return _file_sha256(path)
        files = [item for item in path.rglob("*") if item.is_file()]
        if path.resolve() in output.resolve().parents:
            files = [item for item in files if not item.resolve().is_relative_to(output.resolve())]
        total = hashlib.sha256()
        for file in sorted(files):
            total.update(f"{file.relative_to(path).as_posix()} {_file_sha256(file)}\n".encode())
        return total.hexdigest()
    except OSError as error:
        # An input that was removed during the job must not prevent its report.
        return f"not readable ({error.strerror})"


def _file_sha256(path: Path) -> str:
    if (size := path.stat().st_size) > LIMITS.picture_bytes:  # the largest limit of a file: no reader has read it
        return f"not read ({size} bytes)"
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
