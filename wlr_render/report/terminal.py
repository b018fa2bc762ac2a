"""Reports, tables and progress in the terminal.

Names and messages may come from untrusted files: control characters are escaped, and markup is not interpreted.
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

from wlr_render.io.escapes import printable, printable_lines
from wlr_render.report.blocks import Report, ReportTable
from wlr_render.work.progress import Item, Progress

PIPE_WIDTH = 140
"""Width of output to a file or a pipe, characters."""
MAX_ROWS = 20
"""Largest number of rows of a table in the terminal."""


def say(*lines: object, error: bool = False) -> None:
    """Print lines, escaped, on standard output, or on standard error if `error`."""
    for line in lines:
        print(printable(str(line)), file=_stream(error))


def _stream(error: bool) -> TextIO:
    """Return a standard stream that escapes characters that its encoding lacks."""
    stream = sys.stderr if error else sys.stdout
    if isinstance(stream, io.TextIOWrapper) and stream.errors == "strict":
        stream.reconfigure(errors="backslashreplace")
    return stream


def _console(stderr: bool = False, width: int | None = None) -> Console:
    _stream(stderr)
    return Console(stderr=stderr, width=width, markup=False, emoji=False)


class TerminalProgress(Progress):
    """Progress on standard error, so that standard output stays clean for pipes.

    If standard error is not a terminal, nothing is shown, because its reader expects at most one error message.
    """

    def __init__(self, status: Status) -> None:
        self._status = status

    def __call__(self, items: Iterable[Item], total: int, label: str) -> Iterator[Item]:
        """Yield the items under a progress bar with the time left."""
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
        """Show the current step."""
        self._status.update(Text(printable(text)))
        self._status.start()


@contextmanager
def terminal_progress() -> Iterator[TerminalProgress]:
    """Show the progress of one job, and remove the status line at the end."""
    status = _console(stderr=True).status("")
    try:
        yield TerminalProgress(status)
    finally:
        status.stop()


def print_report(report: Report) -> None:
    """Print a report on standard output: verdict, warnings, advice, tables, files."""
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
