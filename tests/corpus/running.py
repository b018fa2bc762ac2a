"""Run a case from its files to its verdict."""

import contextlib
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from corpus.case import Case
from corpus.judging import PROGRAM, faults, snapshot
from corpus.program import Outcome, limits, run
from corpus.readers import READERS
from wlr_render.errors import BadInputError
from wlr_render.io.escapes import printable


def verdict(bases: Path, case: Case, printed: Callable[[], tuple[str, str]]) -> tuple[list[str], Outcome]:
    """Build, run and judge a case in a temporary folder, which is removed."""
    with tempfile.TemporaryDirectory(prefix="corpus-") as name:
        folder = Path(name) / "case"
        folder.mkdir()
        case.build(bases, folder)
        before = snapshot(folder)
        outcome = _reading(case, folder) or run(case.arguments, folder, case.environment, printed)
        return faults(case, outcome, before, snapshot(folder)), outcome


def _reading(case: Case, folder: Path) -> Outcome | None:
    """What the reader of a spoiled file decides, None if the command is to decide.

    What a command makes of a reader's error is the same for all files: the cases without a reader judge it.
    """
    if case.file not in READERS:
        return None
    began_s, status, sentence = time.process_time(), 0, ""
    with contextlib.chdir(folder), limits() as largest_mb:
        try:
            READERS[case.file](Path(case.file))
        except BadInputError as error:
            status, sentence = 2, f"{PROGRAM}{printable(str(error))}\n"
    if status == 0 and case.expected != "read":
        return None
    return Outcome(status, "", sentence, False, time.process_time() - began_s, largest_mb())
