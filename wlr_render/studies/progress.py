"""How a long job tells how far along it is, without knowing about terminals."""

from collections.abc import Iterable, Iterator
from typing import Protocol, TypeVar

Item = TypeVar("Item")


class Progress(Protocol):
    """Passes items on and shows how far along they are."""

    def __call__(self, items: Iterable[Item], total: int, label: str) -> Iterator[Item]:
        """Yield the items unchanged."""


def silent(items: Iterable[Item], total: int, label: str) -> Iterator[Item]:
    """Show nothing: the default of library calls."""
    yield from items
