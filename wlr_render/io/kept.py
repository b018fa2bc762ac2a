"""The ledger of a job's finished files: an interrupted job continues, and no job replaces another job's files.

The first line is the recipe: the options that change the files, and the input files by their hashes. A line for each
finished file follows, with its length, its SHA-256 and facts for later runs; of several lines for a file, the last one
is valid.
"""

import contextlib
import hashlib
import json
import os
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from wlr_render.errors import BadInputError
from wlr_render.io.atomic_files import NO_DETOUR, disk_errors, write_text
from wlr_render.io.input_files import LIMITS, read_bytes, shown

LEDGER = "finished.jsonl"
Facts = Mapping[str, Any]
Recipe = Mapping[str, Any]
"""Values by option, as JSON has them; a file is a dict of `file_of`, and its path has no effect."""
Signature = tuple[int, str]
"""Length and SHA-256 of a file."""
_REMEDY = "choose another folder or empty it"
_INPUT = "input "
"""Start of the keys of input files in a recipe."""
_LINE_BYTES = 200  # approximate length of a line without facts


class Kept:
    """The finished files of one folder.

    Args:
        folder: folder of the ledger; the files are in it or below.
        recipe: options and inputs that determine the files, as `recipe_of` returns them.
        planned: files that the job writes, with the facts known before; they must not exist without a ledger.
        later_bytes: largest length of the facts that the job adds to each file that has facts.
        replaces: whether files of another recipe of the same job are replaced instead of refused.

    Raises:
        BadInputError: the ledger cannot be read or would become too long, or the folder has files of other options.
    """

    def __init__(
        self,
        folder: Path,
        recipe: Recipe,
        planned: Mapping[Path, Facts] | None = None,
        *,
        later_bytes: int = 0,
        replaces: bool = False,
    ) -> None:
        self._folder, self._path, self._recipe = folder, folder / LEDGER, recipe
        self._listed: dict[str, Facts] = {}
        self._replaced: dict[str, Facts] = {}
        _require_room(self._path, planned or {}, later_bytes)
        content = read_bytes(self._path, LIMITS.record_bytes, _REMEDY) if os.path.lexists(self._path) else b""
        self._is_torn = bool(content) and not content.endswith(b"\n")
        stated: Recipe = {}
        difference = f"{LEDGER} does not state them"
        for line in _lines(content):
            if "recipe" in line:
                stated = line["recipe"]
                difference = _difference(stated, recipe)
            if difference and not (replaces and stated.get("job") == recipe["job"]):
                raise self.refusal(difference)
            if "file" in line:
                (self._replaced if difference else self._listed)[line["file"]] = line
        self._is_begun = not difference
        if not stated and (unlisted := [path for path in planned or {} if os.path.lexists(path)]):
            raise BadInputError(f"{unlisted[0]}: was written by another program or job; {_REMEDY}.")

    def refusal(self, difference: str) -> BadInputError:
        """Return the error of a folder whose files were made with other options or inputs."""
        return BadInputError(f"{self._folder}: belongs to other options: {difference}; {_REMEDY}.")

    def unfinished(self, paths: Iterable[Path]) -> list[Path]:
        """Return the files that are not in the ledger, or do not match it."""
        return [path for path in paths if not _is_whole(path, self._line(path))]

    def changed(self, paths: Iterable[Path]) -> list[Path]:
        """Return existing files that are in the ledger but do not match it."""
        return [path for path in self.unfinished(paths) if self._line(path) and os.path.lexists(path)]

    def facts(self, path: Path) -> Facts:
        """Return the facts of a file, listed by this run or an earlier one; empty for a file that is not listed."""
        facts: Facts = self._line(path).get("facts", {})
        return facts

    def begin(self) -> None:
        """Write the recipe, so that files that a killed run does not list are known to be this job's.

        Raises:
            BadInputError: the ledger cannot be written.
        """
        self.add({})

    def add(self, files: Mapping[Path, Signature], facts: Facts | None = None) -> None:
        """List finished files; the facts belong to the last one.

        Raises:
            BadInputError: the ledger cannot be written.
        """
        signed = [(self._name(path), length, sha256) for path, (length, sha256) in files.items()]
        added = {name: {"file": name, "bytes": length, "sha256": sha256} for name, length, sha256 in signed}
        if facts:
            added[signed[-1][0]]["facts"] = facts
        # A line that a killed run or a full disk has cut off must not spoil the next one.
        content = ("\n" * self._is_torn + self._text(added.values(), with_recipe=not self._is_begun)).encode()
        with disk_errors(self._path), open(self._path, "ab", buffering=0, opener=_open_no_detour) as file:
            self._is_torn = True
            while content:
                content = content[file.write(content) :]  # a full disk may accept only a part
            os.fsync(file.fileno())
        self._is_torn, self._is_begun = False, True
        self._listed |= added

    def remove_replaced(self) -> tuple[int, list[Path]]:
        """Remove the files of the recipes that this one replaces, except files that it has written itself.

        Returns:
            The number of removed files, and the files that were changed since, which are kept.

        Raises:
            BadInputError: the ledger cannot be written.
        """
        removed, changed = 0, []
        for name in self._replaced.keys() - self._listed.keys():
            path = self._folder / name
            if Path(name).name != name or not os.path.lexists(path):
                continue
            if _is_whole(path, self._replaced[name]):
                path.unlink()
                removed += 1
            else:
                changed.append(path)
        if self._replaced:
            write_text(self._path, self._text(self._listed.values()))
        return removed, sorted(changed)

    def _name(self, path: Path) -> str:
        return path.relative_to(self._folder).as_posix()

    def _line(self, path: Path) -> Facts:
        return self._listed.get(self._name(path), {})

    def _text(self, lines: Iterable[Facts], with_recipe: bool = True) -> str:
        stated = [{"recipe": self._recipe}] if with_recipe else []
        return "".join(f"{json.dumps(line)}\n" for line in [*stated, *lines])


def recipe_of(job: str, options: Mapping[str, Any], inputs: Mapping[str, str]) -> Recipe:
    """Return the recipe of a job.

    Args:
        job: name of the job.
        options: value of each option that changes the files; `file_of` for a file that is compared by content.
        inputs: SHA-256 of every file that was read, by path, in the order of reading: exchanged files differ.
    """
    first = {sha256: path for path, sha256 in reversed(list(inputs.items()))}  # a file may be read by two paths
    by_content = [file_of(first[sha256], sha256) for sha256 in dict.fromkeys(inputs.values())]
    files = {f"{_INPUT}{number}": each for number, each in enumerate(by_content, start=1)}
    return dict(json.loads(json.dumps({"job": job} | dict(options) | files)))


def file_of(path: object, sha256: str = "") -> dict[str, str]:
    """Return a file for a recipe: compared by content if its hash is given, else only by presence."""
    return {"file": str(path), "sha256": sha256}


def signatures_of(paths: Iterable[Path]) -> dict[Path, Signature]:
    """Return the length and SHA-256 of files.

    Raises:
        BadInputError: a file cannot be read.
    """
    content = ((path, read_bytes(path, path.stat().st_size)) for path in paths)
    return {path: (len(whole), sha256_of(whole)) for path, whole in content}


def sha256_of(content: bytes) -> str:
    """Return the SHA-256 of bytes, in hexadecimal."""
    return hashlib.sha256(content).hexdigest()


def _difference(was: Recipe, now: Recipe) -> str:
    """Describe the first difference between two recipes; "" if they are equal."""
    for key, (old, new) in differences(was, now).items():
        if key.startswith(_INPUT) or _shown(old) == _shown(new):
            return f"{_shown(new or old)} has changed"
        return f"{key} was {_shown(old)} and is {_shown(new)}"
    return ""


def differences(was: Recipe, now: Recipe) -> dict[str, tuple[object, object]]:
    """Return the old and the new value of all keys in which two recipes differ; None for a missing key."""
    both = {key: (was.get(key), now.get(key)) for key in dict.fromkeys([*now, *was])}
    return {key: (old, new) for key, (old, new) in both.items() if _content(old) != _content(new)}


def in_recipe(value: object) -> str:
    """Return the text of a value of a recipe: a file with the first digits of its hash."""
    sha256 = value.get("sha256") if isinstance(value, dict) else None
    return f"{_shown(value)} (SHA-256 {str(sha256)[:8]}...)" if sha256 else _shown(value)


def _content(value: object) -> object:
    return value.get("sha256") if isinstance(value, dict) else value


def _shown(value: object) -> str:
    value = value.get("file") if isinstance(value, dict) else value
    return value if isinstance(value, str) else shown(value)


def _require_room(path: Path, planned: Mapping[Path, Facts], later_bytes: int) -> None:
    size = sum(_LINE_BYTES + len(json.dumps(facts)) + later_bytes * bool(facts) for facts in planned.values())
    if size > LIMITS.record_bytes:
        raise BadInputError(
            f"{path} of {len(planned)} files would have {size / 1e6:.0f} MB, and at most "
            f"{LIMITS.record_bytes / 1e6:.0f} MB can be read again to continue; cut the job into several, with an "
            "output folder each."
        )


def _is_whole(path: Path, line: Facts) -> bool:
    try:
        is_as_long = path.stat().st_size == line["bytes"]
        return is_as_long and signatures_of([path])[path] == (line["bytes"], line["sha256"])
    except (KeyError, OSError, BadInputError):
        return False


def _open_no_detour(path: str, flags: int) -> int:
    return os.open(path, flags | NO_DETOUR, 0o666)


def _lines(content: bytes) -> Iterator[dict[str, Any]]:
    """Yield the complete lines: the file of a truncated or damaged line counts as unfinished."""
    for text in content.splitlines():
        with contextlib.suppress(ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError):
            line = json.loads(text)
            if "recipe" in line:
                yield {"recipe": dict(line["recipe"])}
            else:
                entry = {"file": str(line["file"]), "bytes": int(line["bytes"]), "sha256": str(line["sha256"])}
                yield entry | ({"facts": dict(line["facts"])} if "facts" in line else {})
