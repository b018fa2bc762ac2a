"""The record of a sequence of frames, `sequence.json`: how, when, from where and from which files they are drawn."""

import itertools
import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from wlr_render.errors import BadInputError
from wlr_render.io.input_files import LIMITS, as_bad_input, read_text, shown
from wlr_render.io.toml_files import parse_json
from wlr_render.jobs.options import Options, flag_of

RECORD = "sequence.json"
_VERSION = 2
_KIND = "the record of a sequence"
_TRAJECTORIES = ("head", "eye_track")
"""Options."""


def sequence_record(
    job: Mapping[str, Any],
    names: Mapping[str, str],
    files: Mapping[str, str],
    inputs: Mapping[str, str],
    frames: Sequence[Mapping[str, Any]],
) -> dict[str, Any]:
    """Return the record of a sequence as plain JSON.

    Args:
        job: the options that change the content of a frame.
        names: names of the headset and the scene, by option; the options themselves may be paths.
        files: SHA-256 of the files that options name, by option.
        inputs: SHA-256 of every file that affects the frames, by its path.
        frames: file, time stamp, viewpoint and head pose of each frame.
    """
    record = {
        "format": "wlr-sequence",
        "version": _VERSION,
        "frame": "openxr",
        "job": dict(job),
        "names": dict(names),
        "files": dict(files),
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


def require_same_job(folder: Path, record: Mapping[str, Any], options: type[Options]) -> None:
    """Refuse a folder whose frames are of other options, or of files that have changed since.

    Raises:
        BadInputError: the sentence names the first difference.
    """
    path = folder / RECORD
    if not os.path.lexists(path):
        if any((folder / frame["file"]).exists() for frame in record["frames"]):
            raise _refusal(folder, f"{RECORD} is missing")
        return
    remedy = "choose another folder or empty it"
    earlier = parse_json(path, read_text(path, _KIND, LIMITS.record_bytes, remedy), _KIND, remedy)
    with as_bad_input(path, _KIND, remedy):
        if earlier["version"] != _VERSION:
            raise BadInputError(
                f"{path}: is of version {shown(earlier['version'])}, and only version {_VERSION} can be continued; "
                f"{remedy}."
            )
        changed = _changed(earlier, record, options)
    if changed:
        raise _refusal(folder, f"{changed} since they were drawn")


def _refusal(folder: Path, reason: str) -> BadInputError:
    return BadInputError(f"{folder}: holds the frames of another job ({reason}); choose another folder or empty it.")


def _changed(earlier: Mapping[str, Any], record: Mapping[str, Any], options: type[Options]) -> str:
    """Describe the first difference between the records of two jobs; "" if they are equal.

    Files are compared by content alone: the same device may have another path in another folder or installation.
    Trajectories are compared by the frames' times, viewpoints and poses: a longer recording continues a sequence.
    """
    was, now = earlier["job"], record["job"]
    for key, value in now.items():
        if not _is_same(earlier, record, key):
            is_file = was[key] == value
            return (
                f"{value} has changed" if is_file else f"{flag_of(options, key)} has changed from {was[key]} to {value}"
            )
    # In the order of reading: two files that are exchanged have changed.
    both = itertools.zip_longest(_by_content(earlier["inputs"]), _by_content(record["inputs"]), fillvalue=("", ""))
    for (sha256_before, path_before), (sha256, path) in both:
        if sha256_before != sha256:
            return f"{path or path_before} has changed"
    # Either may have been limited to fewer frames.
    if any(old != new for old, new in zip(earlier["frames"], record["frames"], strict=False)):
        return f"{' or '.join(str(now[key]) for key in _TRAJECTORIES if now[key]) or 'the eye box'} has changed"
    return ""


def _is_same(earlier: Mapping[str, Any], record: Mapping[str, Any], key: str) -> bool:
    """Return whether an option draws the same frames in both jobs."""
    was, now = earlier["job"][key], record["job"][key]
    if key in _TRAJECTORIES:
        return bool(was) == bool(now)
    if key in earlier["files"] and key in record["files"]:
        return bool(earlier["files"][key] == record["files"][key])
    return bool(was == now)


def _by_content(inputs: Mapping[str, str]) -> list[tuple[str, str]]:
    """SHA-256 and first path of each file; one that is read by two paths is there once."""
    first: dict[str, str] = {}
    for path, sha256 in inputs.items():
        first.setdefault(sha256, path)
    return list(first.items())
