"""Tables of numbers in text files, with line numbers for error messages."""

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from wlr_render.errors import BadInputError
from wlr_render.io.delimited_text import STATED_SEPARATOR, cells_of, is_number, separator_of
from wlr_render.io.input_files import LIMITS, read_text, require_length, shown
from wlr_render.numerics.arrays import FloatArray

UNIT_TOLERANCE = 1e-3
"""Largest deviation of a printed quaternion or direction from unit length; beyond it, the numbers mean other things."""
_SLOWEST_S = 4.0  # longest plausible interval between rows
_FASTEST_M_S = 30.0
_SAME_TIME_S = 1.0  # largest difference of two columns with the same time; one may be cut to whole seconds


@dataclass(frozen=True)
class Row:
    """One line of a table.

    Attributes:
        path: the file.
        line: line number, from 1.
        fields: its cells.
    """

    path: Path
    line: int
    fields: tuple[str, ...]

    def fail(self, sentence: str) -> BadInputError:
        """Return an exception for an error in this line; the caller raises it."""
        return BadInputError(f"{self.path} line {self.line}: {sentence}")

    def require_columns(self, counts: tuple[int, ...], layout: str) -> None:
        """Check the number of columns."""
        if len(self.fields) not in counts:
            allowed = " or ".join(str(count) for count in counts)
            raise self.fail(f"{len(self.fields)} columns where {allowed} are expected ({layout}); correct it.")

    def number(self, column: int) -> float:
        """Return a finite number."""
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
        """Return `count` finite numbers from column `start` on."""
        return [self.number(column) for column in range(start, start + count)]

    def unit_vector(self, columns: Iterable[int], what: str) -> list[float]:
        """Return a unit vector, normalised; refuse numbers whose length is not 1 up to rounding."""
        values = [self.number(column) for column in columns]
        length = math.hypot(*values)
        if abs(length - 1.0) > UNIT_TOLERANCE:
            raise self.fail(f"the {what} has length {length:.6g}, not 1; is the column order right?")
        return [value / length for value in values]


@dataclass(frozen=True)
class NamedColumn:
    """A column that a header names: its index, its name as written, and its unit ("" without one)."""

    index: int
    name: str
    unit: str

    def seconds(self, row: Row) -> float:
        """Return the time of a row in seconds; nanoseconds must be whole, and are read exactly."""
        text, number = row.fields[self.index], row.number(self.index)
        digits = _TIME_UNITS.get(self.unit, 0)
        if self.unit == "" and abs(number) >= _NANOSECONDS:
            digits = 9
        if re.fullmatch(r"[+-]?\d+", text):
            return float(int(text) / 10**digits)
        if digits == 9:
            raise row.fail(
                f"time {shown(text)} is not in integer nanoseconds, as column '{self.name}' says; correct it."
            )
        return float(number / 10**digits)

    def metres(self, row: Row) -> float:
        """Return the length of a row in metres."""
        return float(row.number(self.index) / 10 ** _LENGTH_UNITS[self.unit or "m"])


@dataclass(frozen=True)
class TextTable:
    """A text file of rows and `#` comments.

    Attributes:
        path: the file.
        comments: texts of the comment lines without the #, stripped, in file order.
        rows: the other lines that are not empty, without a header.
        header: cells of a first line that names the columns; None without one.
        headers: cells of each of the last comments before the rows, last one first; all words of a comment that has
            another number of cells than the rows.
        separated: whether the first row has separators other than blanks.
    """

    path: Path
    comments: tuple[str, ...]
    rows: tuple[Row, ...]
    header: tuple[str, ...] | None
    headers: tuple[tuple[str, ...], ...]
    separated: bool

    def unread(self, columns: Mapping[str, NamedColumn]) -> tuple[str, ...]:
        """Return the names in the header that are not among these columns, except EuRoC's velocity and biases."""
        read = {column.index: column.name for column in columns.values()}
        named = (cells for cells in self.headers if len(cells) == len(self.rows[0].fields))
        fitting = (cells for cells in named if all(cells[at] == name for at, name in read.items()))
        cells = self.header or next(fitting, ())
        return tuple(
            name for at, name in enumerate(cells) if at not in read and name and not re.match("(v|b_w|b_a)_RS_", name)
        )

    def columns(self, roles: Mapping[str, str], needed: Sequence[str]) -> dict[str, NamedColumn] | None:
        """Find the columns that a header names, by role; None if no header names any, or comments name less than half.

        Args:
            roles: pattern of a role's name without its unit -> role; it may refer to groups of the pattern.
            needed: roles that a header must name.

        Raises:
            BadInputError: the header lacks a role, names one twice, or states an unknown unit; or a comment that does
                not name the columns lists the parts of the quaternion in another order than TUM's or, in a table with
                separators, EuRoC's.
        """
        for cells in self._names(roles):
            by_role, twice = self._by_role(cells, roles)
            missing = [role for role in needed if role not in by_role]
            if self.header is None and 2 * len(missing) > len(needed):
                continue
            listed = shown(", ".join(cells), quoted=False)
            if missing:
                raise BadInputError(
                    f"{self.path}: the columns {listed} lack {', '.join(missing)}; name them as docs/files.md does, "
                    f"such as {','.join(needed)}, with units as in time_s or x_mm."
                )
            if twice:
                raise BadInputError(f"{self.path}: {twice}.")
            for role, column in by_role.items():
                units = _TIME_UNITS if role == "time" else {"": 0} if role.startswith("q") else _LENGTH_UNITS
                if column.unit not in (*units, ""):
                    raise BadInputError(
                        f"{self.path}: column '{column.name}' is in {column.unit}, which is not read; convert it."
                    )
            return by_role
        quaternion = {role for role in needed if role.startswith("q")}
        usual = ["qw", "qx", "qy", "qz"] if self.separated else ["qx", "qy", "qz", "qw"]
        for words in self.headers if quaternion and self.header is None else ():
            named = [role for word in words if (role := role_of(word, roles)) in quaternion]
            if quaternion <= {*named} and named != usual:
                raise BadInputError(
                    f"{self.path}: the comment {shown(' '.join(words))} names parts of a quaternion, but not each of "
                    f"the {len(self.rows[0].fields)} columns; name them all in one line, such as {','.join(needed)}."
                )
        return None

    def _names(self, roles: Mapping[str, str]) -> Sequence[tuple[str, ...]]:
        """Return the column names of the header or, without one, of each comment with one name per cell.

        A comment may have other words around the names, if every column has a different role.
        """
        if self.header is not None:
            return (self.header,)
        count = len(self.rows[0].fields)
        named = []
        for words in self.headers:
            of_words = [role_of(word, roles) for word in words]
            starts = range(len(words) - count + 1 if len({*of_words} - {""}) >= count else 0)
            distinct = (words[at : at + count] for at in starts if len({*of_words[at : at + count]} - {""}) == count)
            if (names := words if len(words) == count else next(distinct, None)) is not None:
                named.append(names)
        return named

    def _by_role(self, cells: Sequence[str], roles: Mapping[str, str]) -> tuple[dict[str, NamedColumn], str]:
        """Assign columns to roles, keeping the better of two times; also return a sentence on a doubled role."""
        by_role: dict[str, NamedColumn] = {}
        twice = ""
        for index, name in enumerate(cells):
            role = role_of(name, roles)
            unit = _base_and_unit(name)[1]
            is_euroc = role == "time" and any("p_RS_R_" in each for each in cells)
            column = NamedColumn(index, name, unit or ("ns" if is_euroc else ""))
            if role in by_role:
                better = self._better_time(by_role[role], column) if role == "time" else None
                if better is None:
                    twice = f"the columns '{by_role[role].name}' and '{name}' are both {role}; keep one"
                else:
                    by_role[role] = better
            elif role:
                by_role[role] = column
        return by_role, twice

    def _better_time(self, one: NamedColumn, other: NamedColumn) -> NamedColumn | None:
        """Return the better of two time columns: the time stamp, or the finer unit if both agree; None if neither."""
        bases = [_base_and_unit(column.name)[0] for column in (one, other)]
        stamps = [base.endswith("stamp") for base in bases]
        if stamps[0] != stamps[1]:
            return one if stamps[0] else other
        last = max(one.index, other.index)
        ends = [row for row in (self.rows[0], self.rows[-1]) if last < len(row.fields)]
        if bases[0] != bases[1] or one.unit == other.unit or not {one.unit, other.unit} <= {*_TIME_UNITS}:
            return None
        if any(abs(one.seconds(row) - other.seconds(row)) > _SAME_TIME_S for row in ends):
            return None
        return max(one, other, key=lambda column: _TIME_UNITS[column.unit])


_CLOCKS = "header|host|device|frame|sensor|system|unix|utc"
TIME = rf"(?:.*[./]|(?:{_CLOCKS})[_ ])?(?:time|timestamp|time[_ ]stamp|ts|t|stamp)"
"""Pattern of the name of a time, without its unit."""
_TIME_UNITS = dict.fromkeys(("s", "sec", "secs", "second", "seconds"), 0)
_TIME_UNITS |= dict.fromkeys(("ms", "msec", "millisecond", "milliseconds", "millis"), 3)
_TIME_UNITS |= dict.fromkeys(("us", "\u00b5s", "\u03bcs", "usec", "microsecond", "microseconds", "micros"), 6)
_TIME_UNITS |= dict.fromkeys(("ns", "nsec", "nsecs", "nanosec", "nanosecond", "nanoseconds", "nanos"), 9)
"""Units of time as powers of ten: decimal places below a second."""
_LENGTH_UNITS = {"m": 0, "metre": 0, "metres": 0, "meter": 0, "meters": 0, "cm": 2, "mm": 3, "um": 6, "\u00b5m": 6}
_OTHER_UNITS = ("deg", "rad", "px", "in", "inch", "ft", "km", "min", "h")
_NANOSECONDS = 1e17
"""Times without a unit from this value on are nanoseconds since 1970, as in EuRoC."""
_UNIT = re.compile(
    r"^(.*?)\s*(?:[\[(]\s*([^\])]*?)\s*[\])]|[_ ](" + "|".join((*_TIME_UNITS, *_LENGTH_UNITS, *_OTHER_UNITS)) + "))$"
)


def _base_and_unit(name: str) -> tuple[str, str]:
    """Split a column's name into the name and the unit, e.g. of `time [s]`, `time(s)` or `time_s`."""
    plain = re.sub(r"\s+(?![\[(])", "_", name.strip().strip("#% \"'").lower())
    if plain in _TIME_UNITS and len(plain) > 2:
        return "time", plain
    match = _UNIT.match(plain)
    if match is None:
        return plain, ""
    unit = match[2] if match[2] is not None else match[3]
    return match[1], "" if unit in ("-", "1") else unit


def role_of(name: str, roles: Mapping[str, str]) -> str:
    """Return the role of a column by its name; "" for none."""
    base = _base_and_unit(name)[0]
    for pattern, role in roles.items():
        if match := re.fullmatch(pattern, base):
            return match.expand(role)
    return ""


_MOST_COMMENTS = 100  # number of comments before the rows that are searched for column names


def read_text_table(path: str | Path, kind: str = "a trajectory") -> TextTable:
    """Read a file of rows, separated like its first row of numbers: by semicolons, tabs, commas or blanks.

    Args:
        path: the file.
        kind: noun phrase for the file in error messages.

    Raises:
        BadInputError: the file cannot be read or has no rows.
    """
    path = Path(path)
    lines = read_text(path, kind, LIMITS.table_bytes).splitlines()
    if len(lines) > LIMITS.rows:
        raise BadInputError(f"{path}: has {len(lines)} lines, more than {LIMITS.rows}; cut it into parts.")
    stripped = [(number, line.strip()) for number, line in enumerate(lines, start=1) if line.strip()]
    comments = tuple(text.lstrip("#").strip() for _, text in stripped if text.startswith("#"))
    content = [(number, text) for number, text in stripped if not text.startswith("#")]
    if content and STATED_SEPARATOR.fullmatch(content[0][1]):
        content = content[1:]
    named = bool(content) and not is_number(cells_of(content[0][1], separator_of(content[0][1]))[0])
    if len(content) <= named:
        raise BadInputError(f"{path}: has no rows; is {kind} empty?")
    separator = separator_of(content[named][1])
    count = len(_split(content[named][1], separator))
    header = _named_cells(content[0][1], separator, count) if named else None
    count = count if header is None else len(header)
    rows = tuple(Row(path, number, _split(text, separator, count)) for number, text in content[named:])
    before = [text.lstrip("#").strip() for number, text in stripped if text.startswith("#") and number < rows[0].line]
    headers = [_comment_cells(text, separator, len(rows[0].fields)) for text in reversed(before[-_MOST_COMMENTS:])]
    return TextTable(path, comments, rows, header, tuple(headers), separator is not None)


def _named_cells(text: str, separator: str | None, count: int) -> tuple[str, ...]:
    """Split a header into names, with the rows' separator or, if the number of names differs, with another one."""
    joined = _with_units(text)  # a name and its unit form one cell, where blanks separate names
    words = tuple(re.split(r"[,;\s]+", joined.strip(" ,;\t")))
    ways = [words if separator is None else _split(text, separator)]
    ways += [*(_split(joined, other) for other in (",", ";", "\t")), words]
    return next((cells for cells in ways if len(cells) == count), ways[0])


def _comment_cells(text: str, separator: str | None, count: int) -> tuple[str, ...]:
    """Split a comment into names, without leading words and a colon; all words if the names are not `count`."""
    plain = text.replace("`", " ").strip()
    ways = [_named_cells(names, separator, count) for names in (plain, re.sub(r"^[^,;]*:\s+", "", plain))]
    words = re.split(r"[,;\s]+", _with_units(plain))
    cells = [cell.strip(".:'\"") for cell in next((cells for cells in ways if len(cells) == count), words)]
    return tuple(cell if re.search(r"\w\s*[\[(][^\[(]*[\])]$", cell) else cell.strip("()[]") for cell in cells)


def _with_units(text: str) -> str:
    """Return the text without the blanks between a name and its unit in brackets."""
    return re.sub(r"\s+(?=[\[(][^\s,;]*[\])])", "", text)


def _split(text: str, separator: str | None, count: int = 0) -> tuple[str, ...]:
    """Split a row into cells, without an empty last cell beyond the `count` columns."""
    fields = cells_of(text, separator)
    return fields[:-1] if len(fields) > max(count, 1) and fields[-1] == "" else fields


def require_ascending_rows(rows: Sequence[Row], time_s: FloatArray, column: int = 0) -> None:
    """Check that the times (n,) ascend strictly; `column` is the time's column in each row."""
    late = np.flatnonzero(np.diff(time_s) <= 0)
    if late.size:
        row = rows[int(late[0]) + 1]
        raise row.fail(
            f"time {shown(row.fields[column], quoted=False)} does not come after the row before it; sort the rows, "
            "drop duplicates."
        )


def require_plausible_times(where: str, time_s: FloatArray) -> None:
    """Refuse times (n,) that look like milliseconds.

    Raises:
        BadInputError: a time is too large, or the intervals of five or more rows are mostly seconds.
    """
    if np.abs(time_s).max(initial=0.0) > LIMITS.time_s:
        raise BadInputError(
            f"{where}: a time is {np.abs(time_s).max():g} s, more than {LIMITS.time_s:g} s; correct it."
        )
    interval = np.diff(time_s)
    if len(interval) >= 4 and np.median(interval) > _SLOWEST_S:
        raise BadInputError(
            f"{where}: has a row every {np.median(interval):.3g} s, more than the plausible {_SLOWEST_S:g} s; are its "
            "times in milliseconds? Convert them to seconds."
        )


def require_plausible_motion(where: str, time_s: FloatArray, position_m: FloatArray, at_most_m: float) -> None:
    """Refuse trajectories whose positions (n, 3) or times (n,) look like millimetres or milliseconds.

    Raises:
        BadInputError: a position is more than `at_most_m` away, or most rows move faster than people do; see also
            `require_plausible_times`.
    """
    require_length(f"{where}: a position", position_m, at_most_m)
    if len(time_s) > 1:
        speed = np.median(np.linalg.norm(np.diff(position_m, axis=0), axis=1) / np.diff(time_s))
        if speed > _FASTEST_M_S:
            raise BadInputError(
                f"{where}: moves at {speed:.3g} m/s, faster than the plausible {_FASTEST_M_S:g} m/s; are its positions "
                "in millimetres? Convert them to metres, and its times to seconds."
            )
    require_plausible_times(where, time_s)


def shortest(values: Iterable[float]) -> str:
    """Return the numbers separated by blanks, in the shortest decimals that are read back exactly."""
    return " ".join(repr(float(value)) for value in values)
