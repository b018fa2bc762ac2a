"""Files of a job that were written to the end: a list beside them, with the length and the SHA-256 of each.

A run that is resumed keeps the files that are as listed, and makes all others again.
"""

import hashlib
import json
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

from wlr_render.errors import BadInputError
from wlr_render.files import NO_DETOUR, disk_errors
from wlr_render.input_files import LIMITS, read_bytes

LIST = "finished.jsonl"
Signature = tuple[int, str]
"""Length and SHA-256 of a file."""


class FinishedFiles:
    """The list of one folder: one JSON object per line, of which the last one with a name counts.

    Args:
        folder: has the list; the files are in it or below.
        job: digest of what decides the content of the files, "" where another file of the folder records that.

    Raises:
        BadInputError: the list cannot be read, or has files of another job.
    """

    def __init__(self, folder: Path, job: str = "") -> None:
        self._folder, self._path, self._job = folder, folder / LIST, job
        remedy = "choose another folder or empty it"
        self.is_new = not os.path.lexists(self._path)
        content = b"" if self.is_new else read_bytes(self._path, LIMITS.record_bytes, remedy)
        entries = list(_entries(content))
        if any(of != job for _, _, of, _ in entries):
            raise BadInputError(f"{self._path}: lists files of other options or inputs; {remedy}.")
        self._listed = {name: signature for name, signature, _, _ in entries}
        self._blank = {name: blank for name, _, _, blank in entries}
        self._is_torn = bool(content) and not content.endswith(b"\n")

    def not_whole(self, paths: Iterable[Path]) -> list[Path]:
        """Those of these files of the folder that are not listed, or are not as they are listed."""
        return [path for path in paths if not self._is_as_listed(path)]

    def changed(self, paths: Iterable[Path]) -> list[Path]:
        """Those of these files that are listed, and are there, but are not as they are listed."""
        return [path for path in self.not_whole(paths) if self._name(path) in self._listed and os.path.lexists(path)]

    def is_blank(self, path: Path) -> bool:
        """Whether a file was listed as one that shows nothing, by this run or an earlier one."""
        return self._blank.get(self._name(path), False)

    def add(self, paths: Sequence[Path], blank: bool = False) -> None:
        """List files that are finished; `blank` says that they show nothing.

        Raises:
            BadInputError: a file cannot be read, or the list cannot be written.
        """
        self.add_signed({path: signature_of(path) for path in paths}, blank)

    def add_signed(self, signatures: Mapping[Path, Signature], blank: bool = False) -> None:
        """As `add`, of files that another process has finished, with their signatures.

        Raises:
            BadInputError: the list cannot be written.
        """
        lines = [self._line(path, signature, blank) for path, signature in signatures.items()]
        self._blank |= {self._name(path): blank for path in signatures}
        # A line that a killed run, or a full disk, left without its end must not spoil the next one.
        content = ("\n" * self._is_torn + "".join(lines)).encode()
        with disk_errors(self._path), open(self._path, "ab", buffering=0, opener=_open_no_detour) as file:
            self._is_torn = True
            while content:
                content = content[file.write(content) :]  # the last part that a full disk takes may be short
            os.fsync(file.fileno())
            self._is_torn = False

    def _line(self, path: Path, signature: Signature, blank: bool) -> str:
        entry = {"file": self._name(path), "bytes": signature[0], "sha256": signature[1]}
        stated = ({"job": self._job} if self._job else {}) | ({"blank": True} if blank else {})
        return json.dumps(entry | stated) + "\n"

    def _name(self, path: Path) -> str:
        return path.relative_to(self._folder).as_posix()

    def _is_as_listed(self, path: Path) -> bool:
        length, sha256 = self._listed.get(self._name(path), (-1, ""))
        try:
            if path.stat().st_size != length:
                return False
            return hashlib.sha256(read_bytes(path, length)).hexdigest() == sha256
        except (OSError, BadInputError):
            return False


def signature_of(path: Path) -> Signature:
    """Length and SHA-256 of a file.

    Raises:
        BadInputError: it cannot be read.
    """
    content = read_bytes(path, path.stat().st_size)
    return len(content), hashlib.sha256(content).hexdigest()


def digest_of(*what: object) -> str:
    """Digest of what decides the content of files: values that JSON has."""
    return hashlib.sha256(json.dumps(what).encode()).hexdigest()


def _open_no_detour(path: str, flags: int) -> int:
    return os.open(path, flags | NO_DETOUR, 0o666)


def _entries(content: bytes) -> Iterator[tuple[str, Signature, str, bool]]:
    """Name, length and SHA-256, job, and whether the file shows nothing, of each line."""
    for line in content.splitlines():
        try:
            entry = json.loads(line)
            signature = int(entry["bytes"]), str(entry["sha256"])
            yield str(entry["file"]), signature, str(entry.get("job", "")), entry.get("blank") is True
        except (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError):
            pass  # torn, or damaged: its file counts as unfinished
