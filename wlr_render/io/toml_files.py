"""Reading and writing of TOML and JSON files, key by key, with errors that name file, key and value."""

import itertools
import json
import math
import re
import tomllib
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w
from numpy.typing import NDArray

from wlr_render.errors import BadInputError
from wlr_render.io.atomic_files import write_text
from wlr_render.io.input_files import LIMITS, as_bad_input, inside_folder, near_spelling, read_text, shown

_LARGEST = 1e18
"""Largest number in a file: far above every quantity in these units, and its powers do not overflow."""
_LONGEST_TEXT = 2000
_KEYS_COMPARED = 1000
_DEEP_KEY = re.compile(r"""(?<![\w-])(?:(?:[\w-]++|"[^"\n]*"|'[^'\n]*')[ \t]*+\.[ \t]*+){50}""")
"""Dotted keys of 50 parts: the time that `tomllib` takes grows with the square of their number."""


class Table:
    """One table of a TOML file, read key by key; `finish` refuses keys that were not read.

    Errors name the file, the table and the key. Keys have their unit as a suffix
    (`_mm`, `_deg`, `_m`, `_px`, `_s`), so a number without its unit is an unknown key.
    """

    def __init__(self, content: dict[str, Any], where: str) -> None:
        self._content = content
        self._read: set[str] = set()
        self._asked_for: set[str] = set()
        self.where = where

    def fail(self, sentence: str) -> BadInputError:
        """Return the exception for an error in this table; the caller raises it."""
        return BadInputError(f"{self.where}: {sentence}")

    def has(self, key: str) -> bool:
        """Return whether the key is present."""
        self._asked_for.add(key)
        return key in self._content

    def _get(self, key: str) -> Any:
        self._read.add(key)
        if key not in self._content:
            unread = (k for k in self._content if k not in self._read)
            near = near_spelling(key, itertools.islice(unread, _KEYS_COMPARED))
            hint = f" (found {shown(near)} instead)" if near else ""
            raise self.fail(f"key '{key}' is missing{hint}; write it.")
        return self._content[key]

    def text(self, key: str, default: str | None = None, choices: Sequence[str] | None = None) -> str:
        """Return a string, optionally one of `choices`."""
        if default is not None and not self.has(key):
            return default
        value = self._get(key)
        if not isinstance(value, str):
            raise self.fail(f"'{key}' must be text in quotes, not {shown(value)}.")
        if len(value) > _LONGEST_TEXT:
            raise self.fail(f"'{key}' has {len(value)} characters; shorten it to {_LONGEST_TEXT} or fewer.")
        if choices is not None and value not in choices:
            raise self.fail(f"'{key}' is {shown(value)}; it must be one of {', '.join(choices)}.")
        return value

    def file_stem(self, key: str) -> str:
        """Return a string that is safe in names of output files: no folder, hidden file or special character."""
        value = self.text(key)
        if not re.fullmatch(r"\w[\w.-]{0,99}", value):
            raise self.fail(
                f"'{key}' is {shown(value)}; output files are named after it: use letters, digits, '_', '-' and '.' "
                "only, at most 100, and no '-' or '.' first."
            )
        return value

    def path(self, key: str, folder: Path) -> Path:
        """Return the path of another file in the folder of this one or below; see `input_files.inside_folder`."""
        return inside_folder(folder, self.text(key), f"{self.where}: '{key}'")

    def texts(self, key: str) -> list[str]:
        """Return a list of strings, at least one."""
        value = self._get(key)
        if not isinstance(value, list) or not value or not all(isinstance(item, str) for item in value):
            raise self.fail(f"'{key}' must be a list of texts in quotes, not {shown(value)}.")
        return value

    def flag(self, key: str, default: bool) -> bool:
        """Return a boolean."""
        value = self._get(key) if self.has(key) else default
        if not isinstance(value, bool):
            raise self.fail(f"'{key}' must be true or false, not {shown(value)}.")
        return value

    def number(
        self,
        key: str,
        default: float | None = None,
        least: float = -_LARGEST,
        most: float = _LARGEST,
        above: float = -_LARGEST,
    ) -> float:
        """Return a finite number from `least` to `most`, and greater than `above`."""
        if default is not None and not self.has(key):
            return default
        return self._number(self._get(key), key, least, most, above)

    def whole(self, key: str, least: int = 0, most: int = 10**9, default: int | None = None) -> int:
        """Return a whole number from `least` to `most`."""
        value = self.number(key, default)
        if not least <= value <= most or value != int(value):
            raise self.fail(f"'{key}' must be a whole number from {least} to {most}, not {value:g}.")
        return int(value)

    def _number(
        self, value: Any, key: str, least: float = -_LARGEST, most: float = _LARGEST, above: float = -_LARGEST
    ) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self.fail(f"'{key}' must be a number, not {shown(value)}.")
        if value != value or not abs(value) < _LARGEST:  # an integer may be too large for a float
            raise self.fail(f"'{key}' must be finite and below {_LARGEST:g}, not {shown(value)}.")
        if not (least <= value <= most and value > above):
            low = f"above {above:g}" if above >= least else f"{least:g} or more"
            demand = low if most == _LARGEST else f"{low}, and at most {most:g}"
            raise self.fail(f"'{key}' has the value {value:g}; it must be {demand}: correct it, or convert its unit.")
        return float(value)

    def vector(
        self, key: str, size: int, default: Sequence[float] | None = None, **bounds: float
    ) -> NDArray[np.float64]:
        """Return a list of `size` finite numbers, shape (size,); each in the range of `number`."""
        value = self._get(key) if default is None or self.has(key) else list(default)
        if not isinstance(value, list) or len(value) != size:
            raise self.fail(f"'{key}' must be a list of {size} numbers, not {shown(value)}.")
        return np.array([self._number(item, key, **bounds) for item in value])

    def numbers(self, key: str, **bounds: float) -> NDArray[np.float64]:
        """Return a list of any number of finite numbers, shape (n,); each in the range of `number`."""
        value = self._get(key)
        if not isinstance(value, list):
            raise self.fail(f"'{key}' must be a list of numbers, not {shown(value)}.")
        return np.array([self._number(item, key, **bounds) for item in value])

    def vectors(self, key: str, size: int, rows: int | None = None, **bounds: float) -> NDArray[np.float64]:
        """Return `rows` lists, by default any number, of `size` finite numbers each, shape (n, size) with n >= 1."""
        value = self._get(key)
        whole = isinstance(value, list) and value and all(isinstance(row, list) and len(row) == size for row in value)
        if not whole:
            raise self.fail(f"'{key}' must be a list of lists of {size} numbers each, not {shown(value)}.")
        if rows is not None and len(value) != rows:
            raise self.fail(f"'{key}' must be {rows} lists of {size} numbers, not {len(value)}.")
        return np.array([[self._number(item, key, **bounds) for item in row] for row in value])

    def whole_numbers(self, key: str, shape: tuple[int, int]) -> NDArray[np.int64]:
        """Return a list of lists of whole numbers."""
        value, (rows, columns) = self._get(key), shape
        whole = isinstance(value, list) and len(value) == rows
        # Check types row by row, which is faster in a large table than number by number.
        if not whole or not all(
            isinstance(r, list) and len(r) == columns and set(map(type, r)) == {int} for r in value
        ):
            raise self.fail(f"'{key}' must be {rows} lists of {columns} whole numbers; write the file again.")
        try:
            return np.array(value, dtype=np.int64)
        except OverflowError as error:
            raise self.fail(f"'{key}' has a number beyond 64 bits; write the file again.") from error

    def table(self, key: str) -> "Table":
        """Return a sub-table `[key]`."""
        value = self._get(key)
        if not isinstance(value, dict):
            raise self.fail(f"'{key}' must be a table, written [{key}].")
        return Table(value, f"{self.where} [{key}]")

    def tables(self, key: str, required: bool = True, most: int = 100_000) -> list["Table"]:
        """Return an array of at most `most` tables `[[key]]`, in file order."""
        if not required and not self.has(key):
            return []
        value = self._get(key)
        if not isinstance(value, list) or not all(isinstance(item, dict) for item in value):
            raise self.fail(f"'{key}' must be an array of tables, written [[{key}]].")
        if len(value) > most:
            raise self.fail(f"'{key}' has {len(value)} entries; {most} is the most that is read: leave some out.")
        return [Table(item, f"{self.where} [[{key}]] number {i + 1}") for i, item in enumerate(value)]

    def raw(self, key: str) -> Any:
        """Return a raw value of any type; None if it is absent."""
        return self._get(key) if self.has(key) else None

    def raw_table(self, key: str) -> dict[str, Any]:
        """Return a raw sub-table whose content is not checked; empty if it is absent."""
        value = self._get(key) if self.has(key) else {}
        if not isinstance(value, dict):
            raise self.fail(f"'{key}' must be an object.")
        return value

    def keys(self) -> list[str]:
        """Return all keys present, in file order."""
        return list(self._content)

    def check_head(self, format_name: str, newest: int, oldest: int = 0, remedy: str = "write it again") -> int:
        """Check `format`, and `version` (`newest`, or from `oldest` to `newest`); return the version."""
        self.text("format", choices=[format_name])
        version, oldest = self.number("version"), oldest or newest
        if version not in range(oldest, newest + 1):
            reads = f"version {newest}" if oldest == newest else f"versions {oldest} to {newest}"
            raise self.fail(f"has version {version:g}; this program reads {reads}: {remedy}.")
        return int(version)

    def check_unit(self, kind: str) -> None:
        """Check that lengths are in millimetres: `unit = "mm"`."""
        if (unit := self.text("unit")) != "mm":
            raise self.fail(f"'unit' is {shown(unit)}; {kind} is in mm: convert its lengths, write unit = \"mm\".")

    def finish(self) -> None:
        """Refuse keys that were not read, so that typos are reported."""
        for key in self._content:
            if key not in self._read:
                absent = sorted(self._asked_for - self._content.keys())
                near = near_spelling(key, absent)
                remedy = f"did you mean '{near}'?" if near else "remove it."
                raise self.fail(f"unknown key {shown(key)}; {remedy}")


def read_json(path: str | Path, kind: str, remedy: str = "write it again") -> Table:
    """Read a JSON file as a `Table`.

    Raises:
        BadInputError: the file cannot be read, is not a JSON object, or has a key twice; the message says that it is
            not `kind`, and states the remedy.
    """
    content = parse_json(path, read_text(path, kind, LIMITS.data_bytes, remedy), kind, remedy)
    return Table(content, str(path))


def parse_json(path: str | Path, text: str, kind: str, remedy: str) -> dict[str, Any]:
    """Parse the text of a JSON object; errors as `read_json`."""
    with as_bad_input(path, kind, remedy):
        content = json.loads(text, object_pairs_hook=_without_repetition)
    if not isinstance(content, dict):
        raise BadInputError(f"{path}: is not {kind} (its JSON is not an object); {remedy}.")
    return content


def _without_repetition(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    content = dict(pairs)
    if len(content) < len(pairs):
        ((key, _),) = Counter(key for key, _ in pairs).most_common(1)
        raise ValueError(f"key {shown(key)} is there twice")
    return content


def write_json(path: str | Path, value: Any) -> Path:
    """Write JSON atomically, with a line for each entry, and lists without nested tables or lists on one line.

    Raises:
        ValueError: a number is not finite.
    """
    return write_text(path, _json_text(value) + "\n")


def _json_text(value: Any, margin: str = "\n") -> str:
    if isinstance(value, dict) and value:
        entries = [f"{json.dumps(key)}: {_json_text(entry, margin + ' ')}" for key, entry in value.items()]
        opening, closing = "{}"
    elif isinstance(value, list) and any(isinstance(entry, dict | list) for entry in value):
        entries, opening, closing = [_json_text(entry, margin + " ") for entry in value], "[", "]"
    else:
        return json.dumps(value, allow_nan=False, separators=(",", ":"))
    return f"{opening}{margin} " + f",{margin} ".join(entries) + f"{margin}{closing}"


def read_toml(path: str | Path) -> Table:
    """Read a TOML file as a `Table`.

    Raises:
        BadInputError: the file cannot be read or is not TOML; the message states the line.
    """
    text = read_text(path, "a TOML file")
    with as_bad_input(path, "a TOML file", "correct it"):
        if deep := _DEEP_KEY.search(text):
            raise ValueError(f"a key of 50 parts or more at line {text.count(chr(10), 0, deep.start()) + 1}")
        return Table(tomllib.loads(text), str(path))


def write_toml(path: str | Path, table: Mapping[str, Any], comment: str = "") -> Path:
    """Write a TOML file atomically; `read_toml` reads back exactly the same values.

    Args:
        path: path of the file; its folder is made.
        table: text, booleans, integers, floats, lists and arrays of these, tables (mappings) and lists of tables.
        comment: lines at the head of the file, each after a `#`.

    Raises:
        ValueError: a value is not finite or has no TOML type; the sentence names the key.
    """
    head = "".join(f"# {line}".rstrip() + "\n" for line in comment.splitlines())
    return write_text(path, f"{head}\n{toml_text(table)}".lstrip("\n"))


def stated(**keys: Any) -> dict[str, Any]:
    """Return the given keys whose value is not None."""
    return {key: value for key, value in keys.items() if value is not None}


def toml_text(table: Mapping[str, Any]) -> str:
    """Return the text that `write_toml` writes.

    Raises:
        ValueError: a value is not finite or has no TOML type; the sentence names the key.
    """
    content = tomli_w.dumps({key: _toml_value(value, key) for key, value in table.items()})
    # tomli_w puts each number of a vector on a separate line.
    return re.sub(r"\[\n([^\[\]{}\"]+),\n *\]", _on_one_line, content)


def _on_one_line(numbers: re.Match[str]) -> str:
    return "[" + ", ".join(number.strip() for number in numbers[1].split(",")) + "]"


def _toml_value(value: Any, where: str) -> Any:
    """Convert a value for `tomli_w`; refuse values that a `Table` refuses."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, Mapping):
        return {key: _toml_value(item, f"{where}.{key}") for key, item in value.items()}
    if isinstance(value, list | tuple) and len({isinstance(item, Mapping) for item in value}) < 2:
        return [_toml_value(item, where) for item in value]
    if isinstance(value, str | int) or (isinstance(value, float) and math.isfinite(value)):
        return value
    raise ValueError(f"'{where}' cannot be written as TOML: {value!r}.")
