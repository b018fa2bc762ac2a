"""Rows of text tables: separators, quotes and decimal commas as spreadsheets and loggers write them."""

import contextlib
import csv
import re
from collections.abc import Sequence

_DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+(?:[eE][+-]?\d+)?")
_SEPARATED_DECIMAL = re.compile(r"[+-]?\d+,\d+(?:[eE][+-]?\d+)?")

STATED_SEPARATOR = re.compile(r'"?sep=.?"?', re.IGNORECASE)
"""First line with which spreadsheets state the separator; not a row."""


def separator_of(row: str) -> str | None:
    """Return the separator of a row or header: a semicolon, a tab or a comma; None for blanks, or for a single cell.

    A comma after a digit is a decimal comma if blanks separate the numbers.
    """
    bare = re.sub(r'"[^"]*"', "0", row)
    words = bare.split()
    if ";" in bare:
        return ";"
    if "\t" in bare and not all(len(cell.split()) > 1 for cell in bare.split("\t")[1:]):
        return "\t"
    with_comma = [word for word in words if "," in word]
    if not with_comma or (len(words) > 1 and all(map(_SEPARATED_DECIMAL.fullmatch, with_comma))):
        return None
    return ","


def cells_of(row: str, separator: str | None) -> tuple[str, ...]:
    """Return the cells of a row, stripped and without quotes; decimal commas become points.

    A row with invalid quotes is split at every separator.
    """
    cells = row.split(separator)
    if separator is not None and '"' in row:
        with contextlib.suppress(csv.Error):
            cells = next(csv.reader([row.strip()], delimiter=separator, skipinitialspace=True))
    if "," in row and (separator != "," or '"' in row):
        cells = [cell.replace(",", ".") if _DECIMAL_COMMA.fullmatch(cell.strip()) else cell for cell in cells]
    return tuple(cell.strip().strip('"') for cell in cells)


def with_commas(lines: Sequence[str]) -> list[str]:
    """Return the lines of a table, header first, with commas between cells, decimal points and no quotes."""
    separator = separator_of(lines[0]) if lines else ","
    if separator == "," and not any('"' in line for line in lines):
        return [*lines]
    return [",".join(cell.replace(",", ".") for cell in cells_of(line, separator)) for line in lines]


def is_number(cell: str) -> bool:
    """Return whether a cell is a number, with a decimal point."""
    try:
        float(cell)
    except ValueError:
        return False
    return True
