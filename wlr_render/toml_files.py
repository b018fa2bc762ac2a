"""Reading and writing of TOML and JSON files, key by key, with errors that name file, key and value."""

import difflib
import json
import math
import re
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w
from numpy.typing import NDArray

from wlr_render.errors import BadInputError
from wlr_render.files import write_text


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
        """Exception for an error in this table; the caller raises it."""
        return BadInputError(f"{self.where}: {sentence}")

    def has(self, key: str) -> bool:
        """Whether the key is present."""
        self._asked_for.add(key)
        return key in self._content

    def _get(self, key: str) -> Any:
        self._read.add(key)
        if key not in self._content:
            close = difflib.get_close_matches(key, [k for k in self._content if k not in self._read], 1)
            hint = f" (found '{close[0]}' instead)" if close else ""
            raise self.fail(f"key '{key}' is missing{hint}.")
        return self._content[key]

    def text(self, key: str, default: str | None = None, choices: Sequence[str] | None = None) -> str:
        """A string, optionally one of `choices`."""
        if default is not None and not self.has(key):
            return default
        value = self._get(key)
        if not isinstance(value, str):
            raise self.fail(f"'{key}' must be text in quotes, not {value!r}.")
        if choices is not None and value not in choices:
            raise self.fail(f"'{key}' is '{value}'; it must be one of {', '.join(choices)}.")
        return value

    def file_stem(self, key: str) -> str:
        """A string that is safe in names of output files: no folder, hidden file or special character."""
        value = self.text(key)
        if not re.fullmatch(r"\w[\w.-]*", value):
            raise self.fail(
                f"'{key}' is {value!r}; output files are named after it: use letters, digits, '_', '-' and '.' only, "
                "and no '-' or '.' first."
            )
        return value

    def texts(self, key: str) -> list[str]:
        """A list of strings, at least one."""
        value = self._get(key)
        if not isinstance(value, list) or not value or not all(isinstance(item, str) for item in value):
            raise self.fail(f"'{key}' must be a list of texts in quotes, not {value!r}.")
        return value

    def flag(self, key: str, default: bool) -> bool:
        """A boolean."""
        value = self._get(key) if self.has(key) else default
        if not isinstance(value, bool):
            raise self.fail(f"'{key}' must be true or false, not {value!r}.")
        return value

    def number(self, key: str, default: float | None = None) -> float:
        """A finite number."""
        if default is not None and not self.has(key):
            return default
        return self._number(self._get(key), key)

    def whole(self, key: str, least: int = 0) -> int:
        """A whole number of `least` or more."""
        value = self.number(key)
        if value < least or value != int(value):
            raise self.fail(f"'{key}' must be a whole number of {least} or more, not {value:g}.")
        return int(value)

    def _number(self, value: Any, key: str) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self.fail(f"'{key}' must be a number, not {value!r}.")
        if not math.isfinite(value):
            raise self.fail(f"'{key}' must be finite, not {value}.")
        return float(value)

    def vector(self, key: str, size: int, default: Sequence[float] | None = None) -> NDArray[np.float64]:
        """A list of `size` finite numbers, shape (size,)."""
        value = self._get(key) if default is None or self.has(key) else list(default)
        if not isinstance(value, list) or len(value) != size:
            raise self.fail(f"'{key}' must be a list of {size} numbers, not {value!r}.")
        return np.array([self._number(item, key) for item in value])

    def numbers(self, key: str) -> NDArray[np.float64]:
        """A list of any number of finite numbers, shape (n,)."""
        value = self._get(key)
        if not isinstance(value, list):
            raise self.fail(f"'{key}' must be a list of numbers, not {value!r}.")
        return np.array([self._number(item, key) for item in value])

    def vectors(self, key: str, size: int) -> NDArray[np.float64]:
        """A list of lists of `size` finite numbers each, shape (n, size) with n >= 1."""
        value = self._get(key)
        whole = isinstance(value, list) and value and all(isinstance(row, list) and len(row) == size for row in value)
        if not whole:
            raise self.fail(f"'{key}' must be a list of lists of {size} numbers each, not {value!r}.")
        return np.array([[self._number(item, key) for item in row] for row in value])

    def table(self, key: str) -> "Table":
        """A sub-table `[key]`."""
        value = self._get(key)
        if not isinstance(value, dict):
            raise self.fail(f"'{key}' must be a table, written [{key}].")
        return Table(value, f"{self.where} [{key}]")

    def tables(self, key: str, required: bool = True) -> list["Table"]:
        """An array of tables `[[key]]`, in file order."""
        if not required and not self.has(key):
            return []
        value = self._get(key)
        if not isinstance(value, list) or not all(isinstance(item, dict) for item in value):
            raise self.fail(f"'{key}' must be an array of tables, written [[{key}]].")
        return [Table(item, f"{self.where} [[{key}]] number {i + 1}") for i, item in enumerate(value)]

    def unchecked(self, key: str) -> Any:
        """A value of any type; None if it is absent."""
        return self._get(key) if self.has(key) else None

    def free(self, key: str) -> dict[str, Any]:
        """A sub-table whose content is not checked; empty if it is absent."""
        value = self._get(key) if self.has(key) else {}
        if not isinstance(value, dict):
            raise self.fail(f"'{key}' must be an object.")
        return value

    def keys(self) -> list[str]:
        """All keys present, in file order."""
        return list(self._content)

    def check_head(self, format_name: str, version: int, kind: str) -> None:
        """Check the format, version and unit of length of a file: `format`, `version` and `unit = "mm"`."""
        self.text("format", choices=[format_name])
        found, unit = self.number("version"), self.text("unit")
        if found != version:
            raise self.fail(f"'version' is {found:g}; this program reads version {version}: write the file again.")
        if unit != "mm":
            raise self.fail(f"'unit' is '{unit}'; {kind} is in millimetres: convert its lengths, write unit = \"mm\".")

    def finish(self) -> None:
        """Refuse keys that were not read, so that a typing error is not silently ignored."""
        for key in self._content:
            if key not in self._read:
                close = difflib.get_close_matches(key, sorted(self._read | self._asked_for), 1)
                remedy = f"did you mean '{close[0]}'?" if close else "remove it."
                raise self.fail(f"unknown key '{key}'; {remedy}")


def read_json(path: str | Path, kind: str, remedy: str = "write it again") -> Table:
    """Open a JSON file as a `Table`.

    Raises:
        BadInputError: the file cannot be read or is not a JSON object; the sentence says that it is not `kind`, and
            the remedy.
    """
    try:
        content = json.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise BadInputError(f"{path}: cannot be read ({error.strerror}); {remedy}.") from error
    except ValueError as error:
        raise BadInputError(f"{path}: is not {kind}, or is cut short ({error}); {remedy}.") from error
    if not isinstance(content, dict):
        raise BadInputError(f"{path}: is not {kind} (its JSON is not an object); {remedy}.")
    return Table(content, str(path))


def read_toml(path: str | Path) -> Table:
    """Open a TOML file as a `Table`.

    Raises:
        BadInputError: the file cannot be read or is not TOML; the sentence has the line.
    """
    try:
        content = tomllib.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise BadInputError(f"{path}: cannot be read ({error.strerror}).") from error
    except UnicodeDecodeError as error:
        raise BadInputError(f"{path}: is not a text file, so it is not TOML; name another file.") from error
    except tomllib.TOMLDecodeError as error:
        raise BadInputError(f"{path}: is not valid TOML ({error}).") from error
    return Table(content, str(path))


def write_toml(path: str | Path, table: Mapping[str, Any], comment: str = "") -> Path:
    """Write a TOML file atomically; `read_toml` reads back exactly the same values.

    Args:
        path: where; its folder is made.
        table: text, booleans, integers, floats, lists and arrays of these, tables (mappings) and lists of tables.
        comment: put at the head of the file, one `#` a line.

    Raises:
        ValueError: a value is not finite or has no TOML type; the sentence names the key.
    """
    head = "".join(f"# {line}".rstrip() + "\n" for line in comment.splitlines())
    return write_text(path, f"{head}\n{toml_text(table)}".lstrip("\n"))


def toml_text(table: Mapping[str, Any]) -> str:
    """The text that `write_toml` writes.

    Raises:
        ValueError: a value is not finite or has no TOML type; the sentence names the key.
    """
    content = tomli_w.dumps({key: _toml_value(value, key) for key, value in table.items()})
    # tomli_w gives each number of a vector a line of its own.
    return re.sub(r"\[\n([^\[\]{}\"]+),\n *\]", _on_one_line, content)


def _on_one_line(numbers: re.Match[str]) -> str:
    return "[" + ", ".join(number.strip() for number in numbers[1].split(",")) + "]"


def _toml_value(value: Any, where: str) -> Any:
    """Convert a value for `tomli_w`; refuses what a `Table` would refuse."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, Mapping):
        return {key: _toml_value(item, f"{where}.{key}") for key, item in value.items()}
    if isinstance(value, list | tuple) and len({isinstance(item, Mapping) for item in value}) < 2:
        return [_toml_value(item, where) for item in value]
    if isinstance(value, str | int) or (isinstance(value, float) and math.isfinite(value)):
        return value
    raise ValueError(f"'{where}' cannot be written as TOML: {value!r}.")
