"""A case of the corpus: valid files, one change to them, a command, and what must come of it."""

import shutil
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

Change = Callable[[Path], object]
Expected = Literal["refused", "warned", "right", "any", "read"]


def nothing(folder: Path) -> None:
    """Leave the valid files as they are."""


@dataclass(frozen=True)
class Case:
    """One command in a folder of its own.

    Attributes:
        name: kind of input and fault, e.g. "device/panel.pixels=nan".
        arguments: of the command line; paths are relative to the folder.
        files: names of the valid files and folders that are copied into the folder.
        change: spoils them.
        names: words that the sentence must hold; "a|b" is satisfied by either.
        expected: "refused"; "warned" if a sentence on standard output will do too; "right" for success; "any" where
            both success and refusal are right; "read" where both are, and the reader of the file decides.
        file: what is wrong, where the fault lies in one file alone: its reader is asked before the command runs.
        environment: variables of the command.
    """

    name: str
    arguments: tuple[str, ...]
    files: tuple[str, ...] = ()
    change: Change = nothing
    names: tuple[str, ...] = ()
    expected: Expected = "refused"
    file: str = ""
    environment: dict[str, str] = field(default_factory=dict)

    def build(self, bases: Path, folder: Path) -> None:
        """Copy the valid files into an empty folder and spoil them."""
        for name in self.files:
            source = bases / name
            if source.is_dir():
                shutil.copytree(source, folder / name)
            else:
                shutil.copy(source, folder / name)
        self.change(folder)


def written(name: str, content: str | bytes) -> Change:
    """A change that writes a file."""

    def change(folder: Path) -> None:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content if isinstance(content, bytes) else content.encode("utf-8"))

    return change


def edited(name: str, edit: Callable[[bytes], bytes]) -> Change:
    """A change that passes the content of a file through a function, which must change it."""

    def change(folder: Path) -> None:
        old = (folder / name).read_bytes()
        new = edit(old)
        assert new != old, f"the change to {name} must change something"
        (folder / name).write_bytes(new)

    return change


def replaced(name: str, old: str, new: str) -> Change:
    """A change that replaces the first occurrence of a text."""
    return edited(name, lambda content: content.replace(old.encode(), new.encode(), 1))


def several(changes: Iterable[Change]) -> Change:
    """Changes one after the other."""
    listed = tuple(changes)

    def change(folder: Path) -> None:
        for each in listed:
            each(folder)

    return change
