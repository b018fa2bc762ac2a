"""Reports, tables and progress in the terminal.

Names and messages may come from files of others: control characters are escaped and markup is not interpreted.
"""

import io
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import TextIO

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
from rich.progress import Progress as Bar
from rich.status import Status
from rich.table import Table
from rich.text import Text

from wlr_render.escapes import printable, printable_lines
from wlr_render.progress import Item, Progress
from wlr_render.report.blocks import Report, ReportTable

PIPE_WIDTH = 140
"""Columns of output that goes into a file or a pipe."""
MAX_ROWS = 20
"""Rows of a table that the terminal shows."""


def say(*lines: object, error: bool = False) -> None:
    """Print lines, escaped, on standard output, or on standard error if `error`."""
    for line in lines:
        print(printable(str(line)), file=_stream(error))


def _stream(error: bool) -> TextIO:
    """A standard stream, on which characters that its encoding lacks become escapes."""
    stream = sys.stderr if error else sys.stdout
    if isinstance(stream, io.TextIOWrapper) and stream.errors == "strict":
        stream.reconfigure(errors="backslashreplace")
    return stream


def _console(stderr: bool = False, width: int | None = None) -> Console:
    _stream(stderr)
    return Console(stderr=stderr, width=width, markup=False, emoji=False)


class TerminalProgress(Progress):
    """Progress on standard error, so that standard output stays clean for pipes.

    Where standard error is no terminal, nothing is shown: its reader expects at most the one sentence of an error.
    """

    def __init__(self, status: Status) -> None:
        self._status = status

    def __call__(self, items: Iterable[Item], total: int, label: str) -> Iterator[Item]:
        """Yield the items under a bar with the time left."""
        self._status.stop()
        columns = (
            TextColumn("{task.description}", markup=False),
            BarColumn(),
            MofNCompleteColumn(),
            TimeRemainingColumn(),
        )
        with Bar(*columns, console=self._status.console, disable=not self._status.console.is_terminal) as bar:
            task = bar.add_task(printable(label), total=total)
            for item in items:
                yield item
                bar.advance(task)

    def say(self, text: str) -> None:
        """Show what is being done."""
        self._status.update(Text(printable(text)))
        self._status.start()


@contextmanager
def terminal_progress() -> Iterator[TerminalProgress]:
    """Progress for one job; the status line is removed at the end."""
    status = _console(stderr=True).status("")
    try:
        yield TerminalProgress(status)
    finally:
        status.stop()


def print_report(report: Report) -> None:
    """Print a report on standard output: verdict, warnings, what to do, tables, files."""
    say(*filter(None, (report.verdict, *report.warnings)), *(f"{n}. {step}" for n, step in enumerate(report.advice, 1)))
    # A file or a pipe has no window width.
    console = _console(width=None if sys.stdout.isatty() else PIPE_WIDTH)
    for table in report.tables:
        console.print(_drawn(table))
        if len(table.rows) > MAX_ROWS:
            console.print(f"{len(table.rows) - MAX_ROWS} more rows are in the report's files.", style="dim")
        for note in table.notes:
            console.print(printable(note), style="dim", highlight=False)
    if report.files:
        say("Written: " + ", ".join(str(path) for path in report.files))


def _drawn(table: ReportTable) -> Table:
    drawn = Table(title=printable(table.title), title_justify="left")
    for index, column in enumerate(table.columns):
        drawn.add_column(printable(column), justify="left" if index == 0 else "right", overflow="fold")
    for row in table.text_rows()[:MAX_ROWS]:
        drawn.add_row(*map(printable_lines, row))
    return drawn
