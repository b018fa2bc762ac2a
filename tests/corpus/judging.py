"""The rules by which every case is judged."""

import os
import unicodedata
from pathlib import Path

from corpus.case import Case
from corpus.program import Outcome

MOST_MB = 1700  # growth; with the libraries, which take 333 MB, 2 GB
MOST_CPU_S = 20.0
LONGEST_SENTENCE = 1000
"""Room for a list of all causes or methods."""
PROGRAM = "wlr-render: "

Snapshot = dict[str, tuple[int, int]]


def snapshot(folder: Path) -> Snapshot:
    """Files below a folder, with size and time of change."""
    return {
        str((Path(root) / name).relative_to(folder)): (status.st_size, status.st_mtime_ns)
        for root, _, names in os.walk(folder)
        for name in names
        for status in [(Path(root) / name).lstat()]
    }


def faults(case: Case, outcome: Outcome, before: Snapshot, after: Snapshot) -> list[str]:
    """Sentences that say which rules an outcome breaks; empty if none."""
    return [*_ends(case, outcome), *_says(case, outcome), *_uses(outcome), *_leaves(outcome, before, after)]


def _ends(case: Case, outcome: Outcome) -> list[str]:
    found = ["its worker processes outlive it"] if outcome.left else []
    if outcome.status not in (0, 2):
        return [*found, f"its exit status is {outcome.status}"]
    if outcome.status == 2 and case.expected == "right":
        found.append("a valid input is refused")
    if outcome.status == 0 and case.expected == "refused":
        found.append("a wrong input is accepted")
    if outcome.status == 0 and case.expected == "warned" and not _holds(outcome.out, case.names):
        found.append(f"a wrong input is accepted in silence; the output lacks {case.names}")
    return found


def _says(case: Case, outcome: Outcome) -> list[str]:
    found = []
    if "Traceback" in outcome.out + outcome.err:
        found.append("it prints a traceback")
    for stream, text in (("output", outcome.out), ("error", outcome.err)):
        if characters := {char for char in text if char != "\n" and unicodedata.category(char) in ("Cc", "Cf", "Cs")}:
            found.append(f"standard {stream} has the control characters {sorted(characters)!r}")
    lines = outcome.err.splitlines()
    if outcome.status == 0 and lines:
        found.append("it succeeds and writes on standard error")
    if outcome.status != 2:
        return found
    if len(lines) != 1 or not lines[0].startswith(PROGRAM):
        return [*found, f"it refuses in {len(lines)} lines, not in one that begins with '{PROGRAM}'"]
    if len(lines[0]) > LONGEST_SENTENCE:
        found.append(f"its sentence has {len(lines[0])} characters")
    if not _holds(lines[0], case.names):
        found.append(f"its sentence does not name {case.names}")
    return found


def _holds(text: str, names: tuple[str, ...]) -> bool:
    return all(any(each in text for each in name.split("|")) for name in names)


def _uses(outcome: Outcome) -> list[str]:
    found = [f"it takes {outcome.memory_mb:.0f} MB"] if outcome.memory_mb > MOST_MB else []
    return [*found, f"it takes {outcome.cpu_s:.0f} s"] if outcome.cpu_s > MOST_CPU_S else found


def _leaves(outcome: Outcome, before: Snapshot, after: Snapshot) -> list[str]:
    """Outputs go to folders named out, and no command changes an input.

    A refused command leaves no file at all, or only the report that its sentence names.
    """
    new = [name for name in after if name not in before]
    if outcome.status != 0 and "is in out/report.html" in outcome.err:
        new = [name for name in new if Path(name).with_suffix("") != Path("out/report")]
    found = [f"it changes or removes {name}" for name in before if after.get(name) != before[name]]
    found += [f"it leaves {name}" for name in new if outcome.status != 0 or Path(name).parts[0] != "out"]
    return found + [f"it leaves the hidden {name}" for name in new if Path(name).name.startswith(".")]
