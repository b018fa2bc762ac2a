"""A report and its blocks: text, tables, pictures and interactive plots."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from operator import attrgetter
from pathlib import Path
from typing import Any

from wlr_render.html_summary import SummaryTable, html_summary


@dataclass(frozen=True)
class Estimate:
    """A value with its standard error; as text "9.1 +- 0.3", or the value alone if the error is unknown.

    Attributes:
        value: the value; NaN if unknown.
        error: standard error in the same unit; unknown if it is not finite and positive.
        unit: unit after the text; empty if the head of the column states it.
        digits: significant digits of the error in the text.
    """

    value: float
    error: float
    unit: str = ""
    digits: int = field(default=1, metadata={"json": False})

    def __str__(self) -> str:
        text = cell_text(self.value)
        if math.isfinite(self.value) and 0.0 < self.error < math.inf:
            places = decimals(self.error, self.digits)
            text = f"{self.value:.{places}f} +- {self.error:.{places}f}"
        return f"{text} {self.unit}".rstrip()


class Number(float):
    """A number with its text format, e.g. "+.3f"."""

    spec: str

    def __new__(cls, value: float, spec: str = ".3g") -> "Number":
        """Return the number; `spec` is as in `format`, with a default because pickle passes only the value."""
        number = super().__new__(cls, value)
        number.spec = spec
        return number


Cell = str | float | int | Estimate | None
Columns = Mapping[str, str | Callable[[Any], Cell]]
"""Content of the columns of a table by head: an attribute of the row's record, e.g. "before.rms", or a function."""


@dataclass(frozen=True)
class Section:
    """A heading; the blocks after it belong to it."""

    title: str


@dataclass(frozen=True)
class Text:
    """A paragraph, or a list if `items` are given.

    Attributes:
        text: one or more sentences.
        items: entries of a bullet list under the text.
    """

    text: str
    items: Sequence[str] = ()


@dataclass(frozen=True)
class ReportTable:
    """Rows of results under named columns.

    Attributes:
        title: one line.
        columns: column heads with units, e.g. "median (arcmin)".
        rows: one cell per column; None for an empty cell.
        notes: sentences under the table.
    """

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    notes: Sequence[str] = field(default_factory=tuple)

    def text_rows(self) -> list[list[str]]:
        """Return cells as text, numbers with three significant digits."""
        return [[cell_text(cell) for cell in row] for row in self.rows]

    @cached_property
    def word_columns(self) -> list[bool]:
        """One flag per column: True for words (aligned left), False for numbers (aligned right)."""
        return [any(isinstance(row[k], str) for row in self.rows) for k in range(len(self.columns))]

    @property
    def summary(self) -> SummaryTable:
        """The table as notebooks display it, without its notes."""
        return SummaryTable(self.columns, self.text_rows(), self.title)

    def _repr_html_(self) -> str:
        return html_summary(self.title, self.notes, [self.summary._replace(title="")])


def table(
    title: str,
    records: Iterable[Any],
    columns: Columns,
    notes: Sequence[str] = (),
    *,
    name: str = "",
) -> ReportTable:
    """Return a table with one row per record.

    Args:
        title: one line.
        records: objects of one kind, or pairs of a name and an object if `name` is given.
        columns: content of each column.
        notes: sentences under the table.
        name: head of a first column with the names.
    """
    cells = [attrgetter(each) if isinstance(each, str) else each for each in columns.values()]
    if not name:
        return ReportTable(title, tuple(columns), [[cell(record) for cell in cells] for record in records], notes)
    rows = [[first, *(cell(record) for cell in cells)] for first, record in records]
    return ReportTable(title, (name, *columns), rows, notes)


@dataclass(frozen=True)
class Picture:
    """An image file; HTML pages embed it, Markdown links to it.

    Attributes:
        title: one line.
        path: a PNG file.
        caption: one sentence about the content; also the alternative text.
    """

    title: str
    path: Path
    caption: str = ""


@dataclass(frozen=True)
class Plot:
    """A Plotly figure: interactive in HTML pages, with its data in the JSON file.

    Attributes:
        title: one line.
        data: Plotly traces.
        layout: Plotly layout; colours and fonts come from the page.
        caption: one sentence about the content.
        height_px: height in the page.
    """

    title: str
    data: Sequence[Mapping[str, Any]]
    layout: Mapping[str, Any]
    caption: str = ""
    height_px: int = 420


Block = Section | Text | ReportTable | Picture | Plot


@dataclass(frozen=True)
class Report:
    """Result of a job.

    Attributes:
        title: one line, e.g. "Diagnosis of session-7".
        verdict: the result in one or two sentences.
        advice: next steps, most important first.
        warnings: limits of the result.
        blocks: the evidence.
        inputs: files and folders that the result depends on; pages state their SHA-256.
        files: files that the job wrote.
        record: data for the JSON file, a dataclass or a mapping.
        faults: items that could not be used; the command line exits with status 2 if there are any.
        stem: name of its files without the extension; empty if it is only printed.
        verb: name of the job.
        options: value of each option that affects the result, by flag, as `kept.recipe_of` expects them.
    """

    title: str
    verdict: str = ""
    advice: Sequence[str] = ()
    warnings: Sequence[str] = ()
    blocks: Sequence[Block] = ()
    inputs: Sequence[Path] = ()
    files: Sequence[Path] = ()
    record: Any = field(default_factory=dict)
    faults: Sequence[str] = ()
    stem: str = "report"
    verb: str = ""
    options: Mapping[str, Any] = field(default_factory=dict)

    @property
    def tables(self) -> list[ReportTable]:
        """The tables among the blocks."""
        return [block for block in self.blocks if isinstance(block, ReportTable)]

    def _repr_html_(self) -> str:
        """Return verdict, warnings, advice, tables and files as HTML; only the report's page has plots and pictures."""
        steps = [f"{number}. {step}" for number, step in enumerate(self.advice, 1)]
        written = ["Written: " + ", ".join(map(str, self.files))] if self.files else []
        sentences = [sentence for sentence in (self.verdict, *self.warnings, *steps, *written) if sentence]
        return html_summary(self.title, sentences, [table.summary for table in self.tables])


def cell_text(cell: Cell) -> str:
    """Return the text of a cell: floats by their format or with three digits, a dash for an empty cell or NaN."""
    if cell is None or (isinstance(cell, float) and not math.isfinite(cell)):
        return "-"
    if isinstance(cell, Number):
        return format(float(cell), cell.spec)
    if not isinstance(cell, float):
        return str(cell)
    if cell != 0 and abs(cell) < 1e-4:
        return f"{cell:.1e}"
    return f"{cell:.0f}" if abs(cell) >= 1000 else f"{cell:.3g}"


def decimals(error: float, digits: int) -> int:
    """Return the number of decimal places that shows `digits` digits of a standard error; 0 for a large error."""
    rounded = float(f"{error:.{digits - 1}e}")
    return max(0, digits - 1 - math.floor(math.log10(rounded)))


def capitalised(text: str) -> str:
    """Return a text with a capital first letter."""
    return text[:1].upper() + text[1:]
