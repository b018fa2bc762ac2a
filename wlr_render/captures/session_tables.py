"""Read, check and write the tables of a bench session: CSV, plain or gzipped, by their schemas."""

import gzip
import io
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wlr_render.captures.session_schema import NUMBER, POSITIVE, Column, Columns, Schema
from wlr_render.errors import BadInputError
from wlr_render.io.atomic_files import write_bytes
from wlr_render.io.delimited_text import STATED_SEPARATOR, is_number, with_commas
from wlr_render.io.input_files import LIMITS, as_bad_input, decode_text, gunzip, near_spelling, read_bytes, shown
from wlr_render.numerics.arrays import FloatArray

_UNIT_TOLERANCE = 1e-3  # largest error of a unit vector's length, from numbers of four digits
_LONGEST_LINE = 10_000  # most characters of a line: a hundred columns of a hundred characters
_UNIT_SUFFIX = re.compile(r"(_(mm|cm|m|um|inch|deg|rad|mrad|arcmin|px|s|ms|us|min|h))+$")


def read_table(path: Path, schema: Schema) -> Columns:
    """Read a table and check every cell; missing optional columns get their default or are left out.

    Raises:
        BadInputError: a column is missing, unknown or in another unit, a cell is not a number or not allowed in its
            column, the table is empty, or captures contradict or repeat each other.
    """
    lines = _lines(path)
    header = [name.strip() for name in lines[0][1].split(",")] if lines else []
    _check_header(path, header, schema)
    if len(lines) < 2:
        raise BadInputError(f"{path}: has no rows; is the recording empty? Omit the file without rows.")
    numbers = [number for number, _ in lines[1:]]
    values = _values(path, header, [text for _, text in lines[1:]], numbers)
    columns = {name: np.ascontiguousarray(values[:, i]) for i, name in enumerate(header)}
    _check_cells(path, columns, schema, numbers)
    _check_captures(path, columns, schema, numbers)
    filled = {column.name: column.absent for column in schema.columns if column.absent is not None}
    return {name: np.full(len(values), value) for name, value in filled.items()} | columns


def write_table(path: Path, schema: Schema, columns: Mapping[str, FloatArray]) -> Path:
    """Write a table atomically, gzipped if the name ends in .gz; numbers keep 15 digits."""
    written = [column for column in schema.columns if column.name in columns]
    formats = ["%.15g" if column.kind in (NUMBER, POSITIVE) else "%d" for column in written]
    values = np.stack([columns[column.name] for column in written], axis=1)
    text = io.StringIO()
    np.savetxt(text, values, formats, ",", header=",".join(column.name for column in written), comments="")
    content = text.getvalue().encode()
    # Without a time stamp, the same session gives the same file.
    return write_bytes(path, gzip.compress(content, mtime=0) if path.suffix == ".gz" else content)


def _text(path: Path) -> str:
    content = read_bytes(path, LIMITS.table_bytes)
    if path.suffix == ".gz":
        content = gunzip(path, content, LIMITS.table_bytes)
    if content.count(b"\n") > LIMITS.rows:
        raise BadInputError(f"{path}: has more than {LIMITS.rows} rows, the most that are read; leave some out.")
    return decode_text(path, content, "a table")


def _lines(path: Path) -> list[tuple[int, str]]:
    """Return the numbered non-blank lines, converted to comma separators and decimal points."""
    lines = [(number, text) for number, text in enumerate(_text(path).split("\n"), 1) if text.strip()]
    if lines and STATED_SEPARATOR.fullmatch(lines[0][1].strip()):
        lines = lines[1:]
    for number, text in lines:
        if len(text) > _LONGEST_LINE:
            raise BadInputError(
                f"{path} line {number}: has {len(text)} characters, more than any row; separate rows by line ends."
            )
    return [*zip((number for number, _ in lines), with_commas([text for _, text in lines]), strict=True)]


def _check_header(path: Path, header: Sequence[str], schema: Schema) -> None:
    """Refuse unknown, repeated and missing columns."""
    columns = {column.name: column for column in schema.columns}
    for name in header:
        if name not in columns:
            raise BadInputError(
                f"{path}: {_unknown(name, [each for each in columns.values() if each.name not in header])}"
            )
        if header.count(name) > 1:
            raise BadInputError(f"{path}: column '{name}' occurs twice; keep one.")
    present = {column.group for column in schema.columns if column.group and column.name in header}
    for column in schema.columns:
        if column.name not in header and (not column.group or column.group in present):
            unit = f" ({column.unit})" if column.unit else ""
            raise BadInputError(f"{path}: column '{column.name}' is missing; it is {column.meaning}{unit}.")


def _unknown(name: str, absent: Sequence[Column]) -> str:
    """Return the error for a column that the schema does not have."""
    for column in absent:
        if _UNIT_SUFFIX.sub("", name) == _UNIT_SUFFIX.sub("", column.name):
            unit = column.unit or "a bare number"
            return f"column '{name}' has another unit than '{column.name}' ({unit}); convert it and rename it."
    near = near_spelling(name, [column.name for column in absent])
    return f"unknown column '{name}'; " + (f"did you mean '{near}'?" if near else "remove it.")


def _values(path: Path, header: Sequence[str], rows: Sequence[str], numbers: Sequence[int]) -> FloatArray:
    """Return all cells, (n, columns)."""
    try:
        with as_bad_input(path, "a table"):
            values = np.loadtxt(rows, delimiter=",", comments=None, ndmin=2)
    except BadInputError as error:
        raise _cell_fault(path, header, rows, numbers) from error
    if values.shape[1] != len(header):
        raise _cell_fault(path, header, rows, numbers)
    return values


def _cell_fault(path: Path, header: Sequence[str], rows: Sequence[str], numbers: Sequence[int]) -> BadInputError:
    """Return the error for the first row that is not a row of numbers."""
    for number, row in zip(numbers, rows, strict=True):
        cells = row.split(",")
        if len(cells) != len(header):
            return BadInputError(
                f"{path} line {number}: {len(cells)} cells where the header has {len(header)} columns; "
                "write one for each."
            )
        for name, cell in zip(header, cells, strict=True):
            if not is_number(cell):
                return BadInputError(
                    f"{path} line {number}: '{name}' is {shown(cell.strip())}, not a number; {_REMEDY}."
                )
    return BadInputError(f"{path}: the rows are not numbers separated by commas; write the table again.")


_REMEDY = "leave out rows without a measurement"


def _check_cells(path: Path, columns: Columns, schema: Schema, numbers: Sequence[int]) -> None:
    """Refuse values that are not finite or not of the column's kind, and vectors that are not of unit length."""
    for column in schema.columns:
        if column.name not in columns:
            continue
        value = columns[column.name]
        demands = (
            (~np.isfinite(value), f"finite; {_REMEDY}"),
            (~np.asarray(column.kind.holds(value)), column.kind.demand),
            (value < column.least, f"{column.least:g} {column.unit} or more: check its unit"),
            (np.abs(value) > column.largest, f"{column.largest:g} {column.unit}".strip() + " at most: check its unit"),
        )
        for bad, demand in demands:
            if bad.any():
                row = int(np.argmax(bad))
                raise BadInputError(
                    f"{path} line {numbers[row]}: '{column.name}' is {value[row]:g}; it must be {demand}."
                )
    for vector in schema.unit_vectors:
        if vector[0] not in columns:
            continue
        length = np.linalg.norm([columns[name] for name in vector], axis=0)
        bad = np.abs(length - 1.0) > _UNIT_TOLERANCE
        if bad.any():
            row = int(np.argmax(bad))
            raise BadInputError(
                f"{path} line {numbers[row]}: {', '.join(vector)} have length {length[row]:.6g}; it must be 1."
            )


def _check_captures(path: Path, columns: Columns, schema: Schema, numbers: Sequence[int]) -> None:
    """Refuse repeated rows, captures with two setups, and setups with two captures."""
    first = _first_alike(columns, tuple(columns))
    _refuse(path, numbers, first, np.arange(len(numbers)), "is the same row as line {}; remove one")
    setup = tuple(name for name in schema.setup if name in columns)
    if not schema.setup:
        return
    pose = tuple(name for name in schema.capture_key if name != "capture")
    of_capture = _first_alike(columns, schema.capture_key)
    of_setup = _first_alike(columns, (*pose, *setup))
    both = _first_alike(columns, (*schema.capture_key, *setup))
    names = ", ".join(setup)
    wrong = np.flatnonzero(of_capture != both)
    if wrong.size:
        capture = f"capture {columns['capture'][wrong[0]]:.0f}"
        differs = f"{capture} has another setup ({names}) in line {{}}; give each setup its own capture number"
        _refuse(path, numbers, of_capture, both, differs)
    if "time_s" not in setup:
        return  # without times, repeated captures from one position have equal setups
    same = f"the capture in line {{}} has the same setup ({names}); keep one of the two"
    _refuse(path, numbers, of_setup, both, same)


def _first_alike(columns: Columns, names: Sequence[str]) -> NDArray[np.int64]:
    """Return, for each row (n,), the first row with the same values in these columns."""
    key = np.stack([columns[name] for name in names])
    order = np.lexsort(key)
    starts = np.append(True, np.any(key[:, order[1:]] != key[:, order[:-1]], axis=0))
    first = np.empty_like(order)
    # lexsort is stable: the first of several equal rows comes first.
    first[order] = order[starts][np.cumsum(starts) - 1]
    return first


def _refuse(
    path: Path, numbers: Sequence[int], earlier: NDArray[np.int64], group: NDArray[np.int64], sentence: str
) -> None:
    """Refuse the first row where `earlier`, the first row like it, differs from `group`."""
    wrong = np.flatnonzero(earlier != group)
    if wrong.size:
        row = int(wrong[0])
        raise BadInputError(f"{path} line {numbers[row]}: {sentence.format(numbers[int(earlier[row])])}.")
