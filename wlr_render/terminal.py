"""Everything that the program prints: lines, tables and progress bars. Nothing here computes.

Names and messages may come from files of others, so that control characters are escaped and markup is not interpreted.
"""

import sys
import unicodedata
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from rich.console import Console

    from wlr_render.evaluation.report import ReportTable

Item = TypeVar("Item")


def escaped(text: str) -> str:
    """Text with its control, formatting and unencodable characters written as Python escapes, e.g. ESC as `\\x1b`."""
    unsafe = ("Cc", "Cf", "Cs", "Zl", "Zp")
    return "".join(
        char.encode("unicode_escape").decode() if unicodedata.category(char) in unsafe else char for char in text
    )


def say(*lines: object, error: bool = False) -> None:
    """Print lines, escaped, on standard output, or on standard error if `error`."""
    print(*(escaped(str(line)) for line in lines), sep="\n", file=sys.stderr if error else sys.stdout)


def _console(stderr: bool = False, width: int | None = None) -> "Console":
    from rich.console import Console

    return Console(stderr=stderr, width=width, markup=False, emoji=False)


def progress_bar(items: Iterable[Item], total: int, label: str) -> Iterator[Item]:
    """A bar with the time left, on standard error so that standard output stays clean for pipes."""
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    columns = (TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Bar(*columns, console=_console(stderr=True)) as bar:
        task = bar.add_task(escaped(label), total=total)
        for item in items:
            yield item
            bar.advance(task)


@contextmanager
def status_line() -> Iterator[Callable[[str], None]]:
    """A line on standard error that says what is being done; to be told by calling it."""
    from rich.text import Text

    with _console(stderr=True).status("starting") as status:
        yield lambda text: status.update(Text(escaped(text)))


def print_table(table: "ReportTable") -> None:
    """One table on standard output."""
    from rich.table import Table

    drawn = Table(title=escaped(table.title), title_justify="left")
    for index, column in enumerate(table.columns):
        drawn.add_column(escaped(column), justify="left" if index == 0 else "right", overflow="fold")
    for row in table.text_rows():
        drawn.add_row(*map(escaped, row))
    # Into a file or a pipe there is no window whose width would matter.
    console = _console(width=None if sys.stdout.isatty() else 140)
    console.print(drawn)
    for note in table.notes:
        console.print(escaped(note), style="dim", highlight=False)
