"""What the terminal shows: tables and progress bars. Nothing here computes."""

import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import TypeVar

from wlr_render.evaluation.report import ReportTable

Item = TypeVar("Item")


def progress_bar(items: Iterable[Item], total: int, label: str) -> Iterator[Item]:
    """A bar with the time left, on standard error so that standard output stays clean for pipes."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Bar(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task(label, total=total)
        for item in items:
            yield item
            bar.advance(task)


@contextmanager
def status_line() -> Iterator[Callable[[str], None]]:
    """A line on standard error that says what is being done; to be told by calling it."""
    from rich.console import Console
    from rich.markup import escape

    with Console(stderr=True).status("starting") as status:
        yield lambda text: status.update(escape(text))


def print_table(table: ReportTable) -> None:
    """One table on standard output."""
    from rich.console import Console
    from rich.table import Table

    drawn = Table(title=table.title, title_justify="left")
    for index, column in enumerate(table.columns):
        drawn.add_column(column, justify="left" if index == 0 else "right", overflow="fold")
    for row in table.text_rows():
        drawn.add_row(*row)
    # Into a file or a pipe there is no window whose width would matter.
    console = Console() if sys.stdout.isatty() else Console(width=140)
    console.print(drawn)
    for note in table.notes:
        console.print(note, style="dim", highlight=False, markup=False)
