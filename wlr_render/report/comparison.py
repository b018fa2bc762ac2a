"""Comparison of a report with an earlier one of the same verb, by the figures in their JSON files."""

import math
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any, TypeVar

from wlr_render.errors import BadInputError
from wlr_render.io.input_files import shown
from wlr_render.io.kept import Recipe, differences, in_recipe, recipe_of
from wlr_render.io.toml_files import Table, read_json
from wlr_render.report.blocks import Block, Cell, Columns, Estimate, ReportTable, Section, Text, cell_text, table

FORMAT, VERSION = "wlr-report", 1
"""Format of a report's JSON file."""
_SAME = 1e-6  # relative tolerance: repeated fits differ in the last digits
_ROUNDING = 1e-12  # absolute tolerance relative to the largest figure of a column
_REWRITE = "run the verb again to write the report"
_MOST_NAMES = 10  # most rows, columns or tables of one report named in a sentence
_PARTS = ("value", "error")

Item = TypeVar("Item")


@dataclass(frozen=True)
class RecordedTable:
    """A table of a report's JSON file, under the heading `section`."""

    section: str
    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]


@dataclass(frozen=True)
class RecordedReport:
    """The parts of a report's JSON file that are compared.

    Attributes:
        date: date of the report.
        version: version of wlr_render.
        sentence: verdict of the report.
        recipe: options and inputs of the run.
        tables: tables of the report.
    """

    date: str
    version: str
    sentence: str
    recipe: Recipe
    tables: tuple[RecordedTable, ...]

    @classmethod
    def of(cls, table: Table) -> "RecordedReport":
        """Return the report from a JSON object.

        Raises:
            BadInputError: a key is missing or faulty; the sentence names it.
        """
        origin = table.table("provenance")
        inputs = {each.text("name"): each.text("sha256") for each in origin.tables("inputs")}
        return cls(
            origin.text("date"),
            origin.text("version"),
            _words(table, "sentence"),
            recipe_of(origin.text("verb"), origin.raw_table("options"), inputs),
            tuple(map(_table, table.tables("tables"))),
        )


def read_report(given: Path, verb: str) -> RecordedReport:
    """Read an earlier report.

    Args:
        given: one of the report's files, or its folder.
        verb: the verb that must have written it.

    Raises:
        BadInputError: the report is missing, damaged, of another verb, or of another version.
    """
    remedy = f"name a report of {verb}, or run {verb} again to write it"
    path = _json_file(given, remedy)
    table = read_json(path, "a report", remedy)
    if table.text("format", default="") != FORMAT:
        raise table.fail(f"'format' is not '{FORMAT}', as in a report of this version; {remedy}.")
    table.check_head(FORMAT, VERSION, remedy=f"run {verb} again to write it")
    if (other := table.table("provenance").text("verb")) != verb:
        raise table.fail(f"is a report of {shown(other, quoted=False) or 'no verb'}; {remedy}.")
    return RecordedReport.of(table)


def _json_file(given: Path, remedy: str) -> Path:
    """Return the JSON file of a report, given its folder or any of its files.

    Raises:
        BadInputError: the folder has no report, or several.
    """
    if not given.is_dir():
        return given.with_suffix(".json") if given.suffix in (".html", ".md") else given
    found = sorted(path for path in given.glob("*.json") if path.with_suffix(".html").is_file())
    if len(found) != 1:
        holds = f"holds several reports ({', '.join(path.name for path in found)})" if found else "holds no report"
        raise BadInputError(f"{given}: {holds}; {remedy}.")
    return found[0]


def _words(table: Table, key: str) -> str:
    """Return a text of any length."""
    value = table.raw(key)
    if not isinstance(value, str):
        raise table.fail(f"'{key}' must be text in quotes, not {shown(value)}.")
    return value


def _table(table: Table) -> RecordedTable:
    rows = table.tables("rows")
    columns = tuple(rows[0].keys()) if rows else ()
    for row in rows:
        if tuple(row.keys()) != columns:
            raise row.fail(f"has other columns than the first row of the table; {_REWRITE}.")
    cells = tuple(tuple(_cell(row, column) for column in columns) for row in rows)
    return RecordedTable(_words(table, "section"), _words(table, "title"), columns, cells)


def _cell(row: Table, column: str) -> Cell:
    value = row.raw(column)
    if value is None or isinstance(value, str):
        return value
    if isinstance(value, dict):
        estimate = row.table(column)
        # An error without a value has no meaning; an error of 0 is unknown.
        number, error = (_number(estimate, key) for key in ("value", "error"))
        return None if number is None else Estimate(number, error or 0.0, _words(estimate, "unit"))
    return _number(row, column)


def _number(table: Table, key: str) -> float | int | None:
    value = table.raw(key)
    if value is None or (isinstance(value, int | float) and abs(value) <= sys.float_info.max):
        return value
    raise table.fail(f"'{key}' is {shown(value)}; it must be a finite number; {_REWRITE}.")


@dataclass(frozen=True)
class _Figure:
    """One cell in both reports: the label of its row, its column, and the largest figure of that column."""

    label: tuple[Cell, ...]
    column: str
    before: Cell
    now: Cell
    largest: float

    @cached_property
    def both(self) -> tuple[Estimate, Estimate]:
        """The numbers before and now with their errors (0 if unknown); NaN for words, empty cells, different units."""
        before, now = _estimate(self.before), _estimate(self.now)
        return (before, now) if before.unit == now.unit else (Estimate(math.nan, 0.0), Estimate(math.nan, 0.0))

    @property
    def differs(self) -> bool:
        """True if the cells differ by more than rounding."""
        pairs = [(getattr(before, name), getattr(now, name)) for before, now in [self.both] for name in _PARTS]
        is_same = all(math.isclose(*each, rel_tol=_SAME, abs_tol=_ROUNDING * self.largest) for each in pairs)
        return self.before != self.now and not is_same

    @property
    def difference(self) -> float:
        """The value now minus the value before; NaN where they cannot be compared."""
        before, now = self.both
        return now.value - before.value

    @property
    def ratio(self) -> float | None:
        """Ratio of the value now to the value before."""
        before, now = (each.value for each in self.both)
        return now / before if before and math.isfinite(now + before) else None

    @property
    def sigmas(self) -> float | None:
        """The difference in standard errors; None if no error is known."""
        error = math.hypot(*(each.error for each in self.both))
        return self.difference / error if error > 0 else None


def _estimate(cell: Cell) -> Estimate:
    if isinstance(cell, Estimate):
        return cell
    return Estimate(float(cell) if isinstance(cell, int | float) else math.nan, 0.0)


@dataclass(frozen=True)
class _Pair:
    """A table in both reports; `prefix` before the title is its section, if other tables have the same title."""

    before: RecordedTable
    now: RecordedTable
    prefix: str = ""

    @property
    def title(self) -> str:
        """Title of the table; both titles if they differ."""
        one, other = self.now.title, self.before.title
        return f"{self.prefix}{one}" if one == other else f"{self.prefix}{one} (before: {other})"

    @cached_property
    def label_width(self) -> int:
        """Number of leading columns that name a row: the first one, and the text columns that follow it."""
        sides, width = (self.before, self.now), 1
        for number, heads in enumerate(zip(*(each.columns for each in sides), strict=False)):
            has_words = any(isinstance(row[number], str) for each in sides for row in each.rows)
            if heads[0] != heads[1] or (number and not has_words):
                break
            width = number + 1
            if all(len({row[:width] for row in each.rows}) == len(each.rows) for each in sides):
                break
        return width

    def _rows(self, side: RecordedTable) -> dict[tuple[Any, int], dict[str, Cell]]:
        """Return the rows of a side by their labels."""
        width = self.label_width
        cells = (dict(zip(side.columns[width:], row[width:], strict=True)) for row in side.rows)
        return _keyed((row[:width] for row in side.rows), cells)

    @cached_property
    def figures(self) -> list[_Figure]:
        """The cells that both reports have."""
        before, now = self._rows(self.before), self._rows(self.now)
        both = [(key[0], before[key], row) for key, row in now.items() if key in before]
        largest: dict[str, float] = {}
        for _, old, new in both:
            for head in new:
                sizes = [abs(_estimate(row.get(head)).value) for row in (old, new)]
                largest[head] = max([largest.get(head, 0.0), *(size for size in sizes if math.isfinite(size))])
        return [
            _Figure(label, head, old[head], new[head], largest[head])
            for label, old, new in both
            for head in new
            if head in old
        ]

    @property
    def changed(self) -> list[_Figure]:
        """The cells that differ."""
        return [each for each in self.figures if each.differs]

    def only(self, side: RecordedTable) -> list[str]:
        """Return the names of the rows and columns that only one side has."""
        other = self.now if side is self.before else self.before
        heads = [f"column '{head}'" for head in side.columns if other.columns and head not in other.columns]
        others = self._rows(other)
        rows = [_in_words(key[0]) for key in self._rows(side) if key not in others]
        return [f"{self.prefix}{side.title}: {name}" for name in (*heads, *rows)]

    def table(self) -> ReportTable:
        """Return the figures that differ."""
        figures: Columns = {
            "figure": "column",
            "before": "before",
            "now": "now",
            "difference": "difference",
            "now / before": "ratio",
            **({"sigmas": "sigmas"} if any(each.sigmas is not None for each in self.changed) else {}),
        }
        heads = self.now.columns[: self.label_width]
        labels = {f"{head} (row)" if head in figures else head: partial(_label, k) for k, head in enumerate(heads)}
        return table(self.title, self.changed, {**labels, **figures})


def _label(number: int, figure: _Figure) -> Cell:
    return figure.label[number]


def _in_words(label: Iterable[Cell]) -> str:
    return ", ".join(map(cell_text, label))


def _keyed(keys: Iterable[Any], items: Iterable[Item]) -> dict[tuple[Any, int], Item]:
    """Return items by key and number; items with the same key are numbered."""
    found: dict[tuple[Any, int], Item] = {}
    count: Counter[Any] = Counter()
    for key, item in zip(keys, items, strict=True):
        found[key, count[key]] = item
        count[key] += 1
    return found


def _matched(before: Iterable[RecordedTable], now: Sequence[RecordedTable]) -> tuple[list[_Pair], list[list[str]]]:
    """Return the tables of both reports, and the names of tables only in the earlier and only in the later report.

    Tables are matched by section and title; then by section and columns, because a title may state an option.
    """
    keys: list[Callable[[RecordedTable], object]] = [
        lambda each: (each.section, each.title),
        lambda each: (each.section, each.columns),
    ]
    pairs, left = [], [list(before), list(now)]
    for key in keys:
        earlier, later = (_keyed(map(key, side), side) for side in left)
        pairs += [_Pair(earlier[name], later[name]) for name in later if name in earlier]
        left = [[one[name] for name in one if name not in other] for one, other in ((earlier, later), (later, earlier))]
    pairs.sort(key=lambda pair: now.index(pair.now))
    count = Counter(each.title for each in now)
    pairs = [replace(pair, prefix=f"{pair.now.section}: " * (count[pair.now.title] > 1)) for pair in pairs]
    return pairs, [[f"table '{each.title}'" for each in side] for side in left]


def comparison(before: RecordedReport, now: RecordedReport, path: Path) -> list[Block]:
    """Return the section of a report that compares it with an earlier one.

    Args:
        before: the earlier report.
        now: this run's report.
        path: the earlier report as the user names it.
    """
    pairs, tables = _matched(before.tables, now.tables)
    changed = [figure for pair in pairs for figure in pair.changed]
    count = sum(len(pair.figures) for pair in pairs)
    below = ": see the tables below" if changed else ""
    notes = [f"Of {count} figures that both reports have, {len(changed)} differ by more than a millionth{below}."]
    sides = ([pair.before for pair in pairs], [pair.now for pair in pairs])
    for report, alone, side in zip(("earlier report", "report of this run"), tables, sides, strict=True):
        names = [*alone, *(name for pair, each in zip(pairs, side, strict=True) for name in pair.only(each))]
        more = f"; and {len(names) - _MOST_NAMES} more" if len(names) > _MOST_NAMES else ""
        notes += [f"Only in the {report}: {'; '.join(names[:_MOST_NAMES])}{more}."] if names else []
    if any(figure.sigmas is not None for figure in changed):
        notes.append(
            "Sigmas: the difference over the root of the sum of both squared errors, which holds for independent "
            "measurements. Errors of runs on the same measurements are not independent."
        )
    sentences = [f"{when}: {each.sentence}" for when, each in (("Before", before), ("Now", now)) if each.sentence]
    return [
        Section("Comparison with an earlier report"),
        *([Text("", sentences)] if sentences else []),
        replace(_runs(before, now, path), notes=notes),
        *(pair.table() for pair in pairs if pair.changed),
    ]


def _runs(before: RecordedReport, now: RecordedReport, path: Path) -> ReportTable:
    """Return the table of options and inputs that differ."""
    rows: list[list[Cell]] = [["report", f"{path}, {before.date}", f"this one, {now.date}"]]
    rows += [["wlr_render", before.version, now.version]] if before.version != now.version else []
    changed = differences(before.recipe, now.recipe).items()
    rows += [[name, in_recipe(old), in_recipe(new)] for name, (old, new) in changed]
    return ReportTable("Options and inputs that differ", ("option or input", "before", "now"), rows)
