"""Files of a job that were written to the end: a list beside them, with the length and the SHA-256 of each.

A run that is resumed keeps the files that are as listed, and makes all others again.
"""

import hashlib
import json
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

from wlr_render.atomic_files import NO_DETOUR, disk_errors, write_text
from wlr_render.errors import BadInputError
from wlr_render.input_files import LIMITS, read_bytes

LIST = "finished.jsonl"
Signature = tuple[int, str]
"""Length and SHA-256 of a file."""
_ABSENT: Signature = (-1, "")
_REMEDY = "choose another folder or empty it"


class FinishedFiles:
    """The list of one folder: one JSON object per line, of which the last one with a name counts.

    Args:
        folder: has the list; the files are in it or below.
        job: digest of what decides the content of the files, "" where another file of the folder records that.
        kind: start of the digests of jobs whose files this one replaces in the end, with `remove_replaced`.

    Raises:
        BadInputError: the list cannot be read, or has files of another job that this one does not replace.
    """

    def __init__(self, folder: Path, job: str = "", kind: str | None = None) -> None:
        self._folder, self._path, self._job = folder, folder / LIST, job
        self.is_new = not os.path.lexists(self._path)
        content = b"" if self.is_new else read_bytes(self._path, LIMITS.record_bytes, _REMEDY)
        entries = list(_entries(content))
        if any(of != job and (kind is None or not of.startswith(kind)) for _, _, of, _ in entries):
            raise BadInputError(f"{self._path}: lists files of other options or inputs; {_REMEDY}.")
        own = [entry for entry in entries if entry[2] == job]
        self._listed = {name: signature for name, signature, _, _ in own}
        self._remarks = {name: remark for name, _, _, remark in own}
        self._replaced = {name: signature for name, signature, of, _ in entries if of != job}
        self._is_torn = bool(content) and not content.endswith(b"\n")

    def not_whole(self, paths: Iterable[Path]) -> list[Path]:
        """Those of these files of the folder that are not listed, or are not as they are listed."""
        return [path for path in paths if not self._is_as_listed(path)]

    def changed(self, paths: Iterable[Path]) -> list[Path]:
        """Those of these files that are listed, and are there, but are not as they are listed."""
        return [path for path in self.not_whole(paths) if self._name(path) in self._listed and os.path.lexists(path)]

    def remark(self, path: Path) -> str:
        """Return what was remarked on a file when it was listed, by this run or an earlier one; "" if nothing was."""
        return self._remarks.get(self._name(path), "")

    def add(self, paths: Sequence[Path], remark: str = "") -> None:
        """List files that are finished; a `remark` on them is kept for later runs.

        Raises:
            BadInputError: a file cannot be read, or the list cannot be written.
        """
        self.add_signed({path: signature_of(path) for path in paths}, remark)

    def add_signed(self, signatures: Mapping[Path, Signature], remark: str = "") -> None:
        """As `add`, of files that another process has finished, with their signatures.

        Raises:
            BadInputError: the list cannot be written.
        """
        named = {self._name(path): signature for path, signature in signatures.items()}
        self._listed |= named
        self._remarks |= dict.fromkeys(named, remark)
        lines = [self._line(name) for name in named]
        # A line that a killed run, or a full disk, left without its end must not spoil the next one.
        content = ("\n" * self._is_torn + "".join(lines)).encode()
        with disk_errors(self._path), open(self._path, "ab", buffering=0, opener=_open_no_detour) as file:
            self._is_torn = True
            while content:
                content = content[file.write(content) :]  # the last part that a full disk takes may be short
            os.fsync(file.fileno())
            self._is_torn = False

    def remove_replaced(self) -> tuple[int, list[Path]]:
        """Remove the files of the jobs that this one replaces, as far as it has not written files of their names.

        Returns:
            How many were removed, and those that are not as they were listed, because somebody has changed them: they
            are left.

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


def digest_of(*what: object) -> str:
    """Return the digest of what decides the content of files: values that JSON has."""
    return hashlib.sha256(json.dumps(what).encode()).hexdigest()


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
            pass  # torn, or damaged: its file counts as unfinished
