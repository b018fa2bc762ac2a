"""Tables of numbers in text files, with line numbers for error messages."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from wlr_render.errors import BadInputError
from wlr_render.input_files import LIMITS, read_text, require_length, shown
from wlr_render.numerics.arrays import FloatArray

UNIT_TOLERANCE = 1e-3
"""How far a printed quaternion or direction may be from unit length; beyond it, it is something else."""
_SLOWEST_S = 4.0  # between rows
_FASTEST_M_S = 30.0


@dataclass(frozen=True)
class Row:
    """One line of a table.

    Attributes:
        path: the file.
        line: counted from 1.
        fields: the line split at commas or blanks.
    """

    path: Path
    line: int
    fields: tuple[str, ...]

    def fail(self, sentence: str) -> BadInputError:
        """Exception for an error in this line; the caller raises it."""
        return BadInputError(f"{self.path} line {self.line}: {sentence}")

    def require_columns(self, counts: tuple[int, ...], layout: str) -> None:
        """Check the number of columns."""
        if len(self.fields) not in counts:
            allowed = " or ".join(str(count) for count in counts)
            raise self.fail(f"{len(self.fields)} columns where {allowed} are expected ({layout}); correct it.")

    def number(self, column: int) -> float:
        """A finite number."""
        text = self.fields[column]
        try:
            value = float(text)
        except ValueError:
            raise self.fail(f"column {column + 1} is {shown(text)}, not a number; correct it.") from None
        if not np.isfinite(value):
            raise self.fail(
                f"column {column + 1} is {shown(text, quoted=False)}; leave out lines without a measurement."
            )
        return value

    def numbers(self, start: int, count: int) -> list[float]:
        """`count` finite numbers from column `start` on."""
        return [self.number(column) for column in range(start, start + count)]

    def unit_vector(self, start: int, count: int, what: str) -> list[float]:
        """`count` numbers of unit length up to rounding, normalised."""
        values = self.numbers(start, count)
        length = math.hypot(*values)
        if abs(length - 1.0) > UNIT_TOLERANCE:
            raise self.fail(f"the {what} has length {length:.6g}, not 1; is the column order right?")
        return [value / length for value in values]


@dataclass(frozen=True)
class TextTable:
    """A text file of rows and `#` comments.

    Attributes:
        path: the file.
        comments: texts of the comment lines without the #, stripped, in file order.
        rows: the other lines that are not empty.
        comma_separated: whether the first row has a comma.
    """

    path: Path
    comments: tuple[str, ...]
    rows: tuple[Row, ...]
    comma_separated: bool


def read_text_table(path: str | Path) -> TextTable:
    """Read a file of rows, separated by commas if the first row has one, else by blanks.

    Raises:
        BadInputError: the file cannot be read or has no rows.
    """
    path = Path(path)
    lines = read_text(path, "a trajectory", LIMITS.table_bytes).splitlines()
    if len(lines) > LIMITS.rows:
        raise BadInputError(f"{path}: has {len(lines)} lines, more than {LIMITS.rows}; cut it into parts.")
    stripped = [(number, line.strip()) for number, line in enumerate(lines, start=1) if line.strip()]
    comments = tuple(text.lstrip("#").strip() for _, text in stripped if text.startswith("#"))
    content = [(number, text) for number, text in stripped if not text.startswith("#")]
    if not content:
        raise BadInputError(f"{path}: has no rows; is the recording empty?")
    comma_separated = "," in content[0][1]
    rows = tuple(Row(path, number, _split(text, comma_separated)) for number, text in content)
    return TextTable(path, comments, rows, comma_separated)


def _split(text: str, comma_separated: bool) -> tuple[str, ...]:
    if not comma_separated:
        return tuple(text.split())
    fields = tuple(field.strip() for field in text.split(","))
    return fields[:-1] if fields[-1] == "" else fields


def require_ascending_rows(rows: Sequence[Row], time_s: FloatArray) -> None:
    """Check that the times (n,) ascend strictly; the first field of each row is its time."""
    late = np.flatnonzero(np.diff(time_s) <= 0)
    if late.size:
        row = rows[int(late[0]) + 1]
        raise row.fail(
            f"time {shown(row.fields[0], quoted=False)} does not come after the row before it; sort the rows, "
            "drop duplicates."
        )


def require_plausible_motion(where: str, time_s: FloatArray, position_m: FloatArray, at_most_m: float) -> None:
    """Ask about positions (n, 3) in millimetres and times (n,) in milliseconds.

    Raises:
        BadInputError: a position is more than `at_most_m` away, most rows move faster than people do, or most of five
            or more rows are seconds apart.
    """
    if np.abs(time_s).max(initial=0.0) > LIMITS.time_s:
        raise BadInputError(
            f"{where}: a time is {np.abs(time_s).max():g} s, more than {LIMITS.time_s:g} s; correct it."
        )
    require_length(f"{where}: a position", position_m, at_most_m)
    if len(time_s) < 2:
        return
    interval = np.diff(time_s)
    speed = np.median(np.linalg.norm(np.diff(position_m, axis=0), axis=1) / interval)
    if speed > _FASTEST_M_S:
        raise BadInputError(
            f"{where}: moves at {speed:.3g} m/s, faster than the plausible {_FASTEST_M_S:g} m/s; are its positions in "
            "millimetres? Convert them to metres, and its times to seconds."
        )
    if len(interval) >= 4 and np.median(interval) > _SLOWEST_S:
        raise BadInputError(
            f"{where}: has a row every {np.median(interval):.3g} s, more than the plausible {_SLOWEST_S:g} s; are its "
            "times in milliseconds? Convert them to seconds."
        )


def shortest(values: Iterable[float]) -> str:
    """Numbers separated by blanks, in the shortest decimals that are read back exactly."""
    return " ".join(repr(float(value)) for value in values)
