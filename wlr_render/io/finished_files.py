"""Manifest of the finished files of a job, with the length and the SHA-256 of each.

A resumed run keeps the files that match the manifest, and makes all others again.
"""

import hashlib
import json
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

from wlr_render.errors import BadInputError
from wlr_render.io.atomic_files import NO_DETOUR, disk_errors, write_text
from wlr_render.io.input_files import LIMITS, read_bytes

LIST = "finished.jsonl"
Signature = tuple[int, str]
"""Length and SHA-256 of a file."""
_ABSENT: Signature = (-1, "")
_REMEDY = "choose another folder or empty it"


class FinishedFiles:
    """The manifest of one folder: one JSON object per line; the last entry of a name counts.

    Args:
        folder: folder of the manifest; the files are in it or below.
        job: digest of the inputs that determine the files, "" if another file of the folder records them.
        kind: prefix of the digests of jobs whose files `remove_replaced` removes.

    Raises:
        BadInputError: the manifest cannot be read, or has files of another job that this one does not replace.
    """

    def __init__(self, folder: Path, job: str = "", kind: str | None = None) -> None:
        self._folder, self._path, self._job = folder, folder / LIST, job
        self.is_new = not os.path.lexists(self._path)
        content = b"" if self.is_new else read_bytes(self._path, LIMITS.record_bytes, _REMEDY)
        entries = list(_entries(content))
        if any(of != job and (kind is None or not of.startswith(kind)) for _, _, of, _ in entries):
            raise BadInputError(f"{self._path}: lists files of other options or inputs; {_REMEDY}.")
        entries_of_job = [entry for entry in entries if entry[2] == job]
        self._listed = {name: signature for name, signature, _, _ in entries_of_job}
        self._remarks = {name: remark for name, _, _, remark in entries_of_job}
        self._replaced = {name: signature for name, signature, of, _ in entries if of != job}
        self._is_torn = bool(content) and not content.endswith(b"\n")

    def missing_or_changed(self, paths: Iterable[Path]) -> list[Path]:
        """Return the files that are not in the manifest, or do not match it."""
        return [path for path in paths if not self._is_as_listed(path)]

    def changed(self, paths: Iterable[Path]) -> list[Path]:
        """Return the files that are in the manifest and exist, but do not match it."""
        return [
            path
            for path in self.missing_or_changed(paths)
            if self._name(path) in self._listed and os.path.lexists(path)
        ]

    def remark(self, path: Path) -> str:
        """Return the remark on a file, by this run or an earlier one; "" without one."""
        return self._remarks.get(self._name(path), "")

    def add(self, paths: Sequence[Path], remark: str = "") -> None:
        """Add finished files to the manifest, with a `remark` for later runs.

        Raises:
            BadInputError: a file cannot be read, or the list cannot be written.
        """
        self.add_signed({path: signature_of(path) for path in paths}, remark)

    def add_signed(self, signatures: Mapping[Path, Signature], remark: str = "") -> None:
        """Add files with their signatures, which another process has finished, like `add`.

        Raises:
            BadInputError: the list cannot be written.
        """
        named = {self._name(path): signature for path, signature in signatures.items()}
        self._listed |= named
        self._remarks |= dict.fromkeys(named, remark)
        lines = [self._line(name) for name in named]
        # A line cut off by a killed run or a full disk must not spoil the next one.
        content = ("\n" * self._is_torn + "".join(lines)).encode()
        with disk_errors(self._path), open(self._path, "ab", buffering=0, opener=_open_no_detour) as file:
            self._is_torn = True
            while content:
                content = content[file.write(content) :]  # a full disk may take only a part
            os.fsync(file.fileno())
            self._is_torn = False

    def remove_replaced(self) -> tuple[int, list[Path]]:
        """Remove the files of the jobs that this one replaces, except files that it has written itself.

        Returns:
            The number of removed files, and the files that somebody has changed since, which are left.

        Raises:
            BadInputError: the list cannot be written.
        """
        removed, changed = 0, []
        for name in self._replaced.keys() - self._listed.keys():
            path = self._folder / name
            if Path(name).name != name or not os.path.lexists(path):
                continue
            if _has_signature(path, self._replaced[name]):
                path.unlink()
                removed += 1
            else:
                changed.append(path)
        if self._replaced:
            write_text(self._path, "".join(map(self._line, self._listed)))
        return removed, sorted(changed)

    def _line(self, name: str) -> str:
        (length, sha256), remark = self._listed[name], self._remarks[name]
        entry = {"file": name, "bytes": length, "sha256": sha256}
        stated = ({"job": self._job} if self._job else {}) | ({"remark": remark} if remark else {})
        return json.dumps(entry | stated) + "\n"

    def _name(self, path: Path) -> str:
        return path.relative_to(self._folder).as_posix()

    def _is_as_listed(self, path: Path) -> bool:
        return _has_signature(path, self._listed.get(self._name(path), _ABSENT))


def _has_signature(path: Path, signature: Signature) -> bool:
    length, sha256 = signature
    try:
        if path.stat().st_size != length:
            return False
        return hashlib.sha256(read_bytes(path, length)).hexdigest() == sha256
    except (OSError, BadInputError):
        return False


def signature_of(path: Path) -> Signature:
    """Return the length and SHA-256 of a file.

    Raises:
        BadInputError: it cannot be read.
    """
    content = read_bytes(path, path.stat().st_size)
    return len(content), hashlib.sha256(content).hexdigest()


def digest_of(*inputs: object) -> str:
    """Return the digest of the inputs that determine files, as JSON values."""
    return hashlib.sha256(json.dumps(inputs).encode()).hexdigest()


def _open_no_detour(path: str, flags: int) -> int:
    return os.open(path, flags | NO_DETOUR, 0o666)


def _entries(content: bytes) -> Iterator[tuple[str, Signature, str, str]]:
    """Yield the name, length and SHA-256, job, and remark of each line."""
    for line in content.splitlines():
        try:
            entry = json.loads(line)
            signature = int(entry["bytes"]), str(entry["sha256"])
            yield str(entry["file"]), signature, str(entry.get("job", "")), str(entry.get("remark", ""))
        except (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError):
            pass  # cut off or damaged: its file counts as unfinished
