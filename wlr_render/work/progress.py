"""Progress of a long job, shown by the caller."""

from collections.abc import Iterable, Iterator
from typing import TypeVar

Item = TypeVar("Item")


class Progress:
    """Receiver of a job's progress that shows nothing: the default of library calls."""

    def __call__(self, items: Iterable[Item], total: int, label: str) -> Iterator[Item]:
        """Yield the items unchanged."""
        yield from items

    def say(self, text: str) -> None:
        """Note the current activity, e.g. "reading the session"."""


SILENT = Progress()
