"""Run a case from its files to its verdict."""

import fcntl
import tempfile
from collections.abc import Callable
from pathlib import Path

from corpus.case import Case
from corpus.judging import faults, snapshot
from corpus.zygote import Outcome, Zygote


def verdict(zygote: Zygote, bases: Path, case: Case) -> tuple[list[str], Outcome]:
    """Build, run and judge a case in a temporary folder, which is removed."""
    with tempfile.TemporaryDirectory(prefix="corpus-") as name:
        folder = Path(name) / "case"
        folder.mkdir()
        case.build(bases, folder)
        before = snapshot(folder)
        outcome = zygote.run(case.arguments, folder, Path(name) / "stream", case.environment)
        return faults(case, outcome, before, snapshot(folder)), outcome


def made_once(folder: Path, make: Callable[[Path], object]) -> Path:
    """The folder of valid files, which the first of several processes makes."""
    with open(folder.with_suffix(".lock"), "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not folder.exists():
            making = folder.with_suffix(".making")
            making.mkdir()
            make(making)
            making.rename(folder)
    return folder
