"""Paths of shipped files, atomic writing of every output, and reading and writing of TOML.

Every output is encoded in memory, goes to a temporary name in the same folder, is flushed to the disk, and is then
renamed: readers never find a partial file, and a full disk or a failed run leaves the old file in place.
"""

import contextlib
import difflib
import io
import json
import math
import os
import re
import tempfile
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import tomli_w
from numpy.typing import NDArray

from wlr_render.errors import BadInputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_PACKAGE = Path(__file__).resolve().parent


def _umask() -> int:
    """Umask of the process. Reading it requires setting it, which is not safe with other threads."""
    umask = os.umask(0)
    os.umask(umask)
    return umask


_FILE_MODE = 0o666 & ~_umask()


def resource(folder: str, name: str = "") -> Path:
    """Path of a shipped file: `folder` is "devices", "docs", "scenes" or "shaders".

    These folders are inside the package in a wheel, and beside it in a checkout.
    """
    for root in (_PACKAGE, _PACKAGE.parent):
        path = root / folder / name
        if path.exists():
            return path
    raise BadInputError(f"The shipped file {folder}/{name} is missing: install wlr_render again.")


def shipped_names(folder: str, suffix: str) -> list[str]:
    """Stems of the shipped files of one kind, sorted, e.g. shipped_names("devices", ".toml")."""
    return sorted(path.stem for path in resource(folder).glob(f"*{suffix}"))


def named_or_path(folder: str, spec: str | Path) -> Path:
    """Path of a shipped file by its name, or of any file by its path.

    Raises:
        BadInputError: there is no such file; the sentence lists the shipped names.
    """
    path = Path(spec)
    names = shipped_names(folder, ".toml")
    if str(spec) in names:
        return resource(folder, f"{spec}.toml")
    if path.is_dir():
        model = path / "model.json"
        raise BadInputError(f"{path}: is a folder; name {model if model.is_file() else 'a file in it'}.")
    if path.suffix == ".toml" or len(path.parts) > 1:
        if not path.is_file():
            raise BadInputError(f"{path}: there is no such file.")
        return path
    close = difflib.get_close_matches(str(spec), names, 1)
    hint = f" Did you mean {close[0]}?" if close else ""
    raise BadInputError(f"'{spec}' is neither a file nor one of the shipped {folder} ({', '.join(names)}).{hint}")


def output_folder(path: str | Path) -> Path:
    """Create an output folder if necessary, and check that it can be written."""
    folder = Path(path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        reason = error.strerror or str(error)
        raise BadInputError(f"{folder}: cannot write to this output folder ({reason}); choose another.") from error
    return folder


@contextlib.contextmanager
def written_whole(path: str | Path) -> Iterator[Path]:
    """Context manager for a temporary path, which is renamed to `path` if the block ends without an error.

    For encoders that need a path, such as video encoders. `write_bytes` writes everything else.

    Raises:
        BadInputError: the folder cannot be written, or the file cannot be flushed.
    """
    target = Path(path)
    output_folder(target.parent)
    with _disk_errors(path):
        handle, name = tempfile.mkstemp(prefix=f".{target.stem}.", suffix=target.suffix, dir=target.parent)
        os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        with _disk_errors(path):
            with temporary.open("rb+") as file:
                os.fsync(file.fileno())
            temporary.chmod(_FILE_MODE)
            temporary.replace(target)
    finally:
        temporary.unlink(missing_ok=True)


@contextlib.contextmanager
def _disk_errors(path: str | Path) -> Iterator[None]:
    """Convert errors of the disk to a `BadInputError` that says why `path` cannot be written."""
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error)
        raise BadInputError(f"{path}: cannot be written ({reason}); free space or choose another folder.") from error


def write_bytes(path: str | Path, content: bytes | memoryview) -> Path:
    """Write a file atomically.

    Raises:
        BadInputError: the disk is full, or the folder cannot be written.
    """
    with written_whole(path) as temporary, _disk_errors(path):
        temporary.write_bytes(content)
    return Path(path)


def write_text(path: str | Path, text: str) -> Path:
    """Write a UTF-8 text file with `write_bytes`."""
    return write_bytes(path, text.encode("utf-8"))


def write_image(path: str | Path, image: NDArray[np.generic], parameters: Sequence[int] = ()) -> Path:
    """Write an image (colours in BGR order) in the format of the path's suffix.

    Args:
        path: where.
        image: (height, width) or (height, width, 3).
        parameters: of `cv2.imencode`.

    Raises:
        BadInputError: OpenCV cannot encode this array in this format, or the disk is full.
    """
    import cv2

    try:
        encoded, content = cv2.imencode(Path(path).suffix, image, parameters)
    except cv2.error:
        encoded = False
    if not encoded:
        raise BadInputError(f"{path}: OpenCV cannot write this kind of picture; name it .png.")
    return write_bytes(path, content.data)


def write_figure(path: str | Path, figure: "Figure", dpi: float | None = None) -> Path:
    """Write a matplotlib figure in the format of the path's suffix; `dpi` is the figure's own by default."""
    content = io.BytesIO()
    figure.savefig(content, format=Path(path).suffix[1:], dpi=dpi or "figure")
    return write_bytes(path, content.getbuffer())


def write_arrays(path: str | Path, arrays: Mapping[str, NDArray[Any]]) -> Path:
    """Write named arrays as a compressed .npz, without pickled objects."""
    content = io.BytesIO()
    np.savez_compressed(content, allow_pickle=False, **arrays)
    return write_bytes(path, content.getbuffer())


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
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
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
    content = tomli_w.dumps({key: _toml_value(value, key) for key, value in table.items()})
    # tomli_w gives each number of a vector a line of its own.
    content = re.sub(r"\[\n([^\[\]{}\"]+),\n *\]", _on_one_line, content)
    return write_text(path, f"{head}\n{content}".lstrip("\n"))


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
