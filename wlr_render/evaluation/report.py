"""A table of results, as Markdown and as JSON; the terminal draws it too."""

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, field

Cell = str | float | int | None


@dataclass(frozen=True)
class ReportTable:
    """Rows of results under named columns.

    Attributes:
        title: one line.
        columns: heads, units included, e.g. "median (arcmin)".
        rows: one cell per column; None where there is nothing.
        notes: sentences that belong to the table.
    """

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    notes: Sequence[str] = field(default_factory=tuple)

    def text_rows(self) -> list[list[str]]:
        """Cells as text, numbers with three significant digits."""
        return [[cell_text(cell) for cell in row] for row in self.rows]

    def markdown(self) -> str:
        """A Markdown table with its title and notes."""
        lines = [f"### {self.title}", "", _line(self.columns), _line(["---"] * len(self.columns))]
        lines += [_line(row) for row in self.text_rows()]
        lines += ["", *self.notes] if self.notes else []
        return "\n".join(lines) + "\n"

    def as_record(self) -> dict[str, object]:
        """For JSON: full-precision numbers, NaN as null."""
        rows = [[None if isinstance(c, float) and not math.isfinite(c) else c for c in row] for row in self.rows]
        records = [dict(zip(self.columns, row, strict=True)) for row in rows]
        return {"title": self.title, "rows": records, "notes": list(self.notes)}


def cell_text(cell: Cell) -> str:
    """One cell: three significant digits for floats, a dash for nothing."""
    if cell is None or (isinstance(cell, float) and not math.isfinite(cell)):
        return "-"
    if not isinstance(cell, float):
        return str(cell)
    if cell != 0 and abs(cell) < 1e-4:
        return f"{cell:.1e}"
    return f"{cell:.0f}" if abs(cell) >= 1000 else f"{cell:.3g}"


def _line(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def tables_as_json(tables: Sequence[ReportTable], **context: object) -> str:
    """Several tables and what they were made with, as one JSON text."""
    return json.dumps({**context, "tables": [table.as_record() for table in tables]}, indent=2) + "\n"
