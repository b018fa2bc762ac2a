"""The record of a sequence of frames, `sequence.json`: how, when, from where and from which files they are drawn."""

import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from wlr_render.errors import BadInputError
from wlr_render.input_files import LIMITS, parsing, read_text
from wlr_render.jobs.options import Options, flag_of
from wlr_render.toml_files import parse_json

RECORD = "sequence.json"
_VERSION = 2
_KIND = "the record of a sequence"
_ABSENT_IN_OLD_RECORDS: dict[str, Any] = {
    "raster_camera": "nearest",
    "predicted_error": None,
    "samples": 64,
    "bounces": 4,
    "seed": 0,
    "layers": [],
    "misalignment": None,
}
"""Options that earlier versions did not write, with the value that stands for theirs."""


def sequence_record(
    job: Mapping[str, Any], inputs: Mapping[str, str], frames: Sequence[Mapping[str, Any]]
) -> dict[str, Any]:
    """Record as plain JSON.

    Args:
        job: the options that change what a frame shows.
        inputs: SHA-256 of every file that the frames show, by its path.
        frames: file, time stamp, viewpoint and head pose of each frame.
    """
    record = {
        "format": "wlr-sequence",
        "version": _VERSION,
        "frame": "openxr",
        "job": dict(job),
        "inputs": dict(inputs),
        "frames": list(frames),
    }
    return dict(json.loads(json.dumps(record)))


def record_text(record: Mapping[str, Any]) -> str:
    """Text of a record, with one line for each frame.

    Raises:
        BadInputError: it would be too long to be read again.
    """
    frames = ",\n".join(f"  {json.dumps(frame)}" for frame in record["frames"])
    head = json.dumps({key: value for key, value in record.items() if key != "frames"}, indent=1)
    text = f'{head[:-2]},\n "frames": [\n{frames}\n ]\n}}\n'
    if len(text) > LIMITS.record_bytes:
        raise BadInputError(
            f"{RECORD} of {len(record['frames'])} frames has {len(text) / 1e6:.0f} MB, and at most "
            f"{LIMITS.record_bytes / 1e6:.0f} MB can be read again to continue; cut the trajectory into sequences with "
            "an output folder each."
        )
    return text


def require_same_job(
    folder: Path, record: Mapping[str, Any], options: type[Options], trajectories: Sequence[Path]
) -> bool:
    """Refuse a folder whose frames are of other options, or of files that have changed since.

    Returns:
        Whether the frames were drawn by an earlier version, which did not list finished files.

    Raises:
        BadInputError: the sentence names the first difference.
    """
    path = folder / RECORD
    if not os.path.lexists(path):
        if any((folder / frame["file"]).exists() for frame in record["frames"]):
            raise _refusal(folder, f"{RECORD} is missing")
        return False
    remedy = "choose another folder or empty it"
    earlier = parse_json(path, read_text(path, _KIND, LIMITS.record_bytes, remedy), _KIND, remedy)
    with parsing(path, _KIND, remedy):
        is_old = bool(earlier["version"] == 1)
        changed = _changed(earlier, record, options, trajectories)
    if changed:
        raise _refusal(folder, f"{changed} since they were drawn")
    return is_old


def _refusal(folder: Path, reason: str) -> BadInputError:
    return BadInputError(f"{folder}: holds the frames of another job ({reason}); choose another folder or empty it.")


def _changed(
    earlier: dict[str, Any], record: Mapping[str, Any], options: type[Options], trajectories: Sequence[Path]
) -> str:
    """The first difference between the records of two jobs in words, "" if there is none."""
    job, inputs = {**_ABSENT_IN_OLD_RECORDS, **earlier["job"]}, record["inputs"]
    for key, value in record["job"].items():
        if job[key] != value:
            return f"{flag_of(options, key)} has changed from {job[key]} to {value}"
    # Files are compared by content alone: the same device may have another path in another installation.
    if earlier["version"] == 1:
        old = [("the headset or the scene", sha256) for sha256 in job["sha256"]]
        new = []  # not all files were recorded
    else:
        old = list(earlier["inputs"].items())
        new = [name for name, sha256 in inputs.items() if sha256 not in earlier["inputs"].values()]
    different = new or [name for name, sha256 in old if sha256 not in inputs.values()]
    if different:
        return f"{different[0]} has changed"
    # Either may have been limited to fewer frames.
    if any(old != new for old, new in zip(earlier["frames"], record["frames"], strict=False)):
        return f"{' or '.join(map(str, trajectories)) or 'the eye box'} has changed"
    return ""
