"""The program in hostile surroundings: closed and full streams, read-only and missing folders, other languages.

Each is a fresh process, as a fork would inherit the surroundings of the tests.
"""

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from corpus.case import Case, Expected
from corpus.judging import PROGRAM, faults, snapshot
from corpus.program import Outcome

PROGRAM_WORDS = f"{sys.executable} -m wlr_render"
GOOD = "render device.toml scene.toml --backend cpu --out out"
BAD = "render nowhere.toml scene.toml --out out"
FILES = ("device.toml", "scene.toml", "box.obj")
ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def folder(bases: Path, tmp_path: Path) -> Path:
    made = tmp_path / "case"
    made.mkdir()
    Case("", (), FILES).build(bases, made)
    return made


def run(command: str, folder: Path, **environment: Any) -> Outcome:
    """Run a shell command whose `@` stands for the program."""
    surroundings = os.environ | {"PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1"} | environment
    kept = {name: value for name, value in surroundings.items() if value is not None}
    words = ["bash", "-c", command.replace("@", PROGRAM_WORDS)]
    done = subprocess.run(words, cwd=folder, env=kept, capture_output=True, timeout=90, check=False)
    return Outcome(done.returncode, done.stdout.decode(), done.stderr.decode(), False, 0.0, 0.0)


def judged(folder: Path, command: str, expected: Expected, names: tuple[str, ...] = (), **environment: Any) -> Outcome:
    before = snapshot(folder)
    outcome = run(command, folder, **environment)
    case = replace(Case("", (), names=names), expected=expected)
    assert faults(case, outcome, before, snapshot(folder)) == [], f"{outcome.status} {outcome.out}{outcome.err}"
    return outcome


ASCII = {"PYTHONIOENCODING": "ascii", "LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
# Each holds variables that do not act on each other.
ENVIRONMENTS: dict[str, Any] = {
    "ASCII, 20 columns, HOME nowhere, dumb terminal": ASCII
    | {"COLUMNS": "20", "HOME": "/nowhere/at/all", "TERM": "dumb", "NO_COLOR": "1", "TZ": "nowhere/at/all"},
    "LANG=C, 1 column, no HOME, all warnings": {
        "LANG": "C",
        "LC_ALL": "C",
        "COLUMNS": "1",
        "LINES": "1",
        "HOME": None,
        "PYTHONWARNINGS": "always",
    },
    "no terminal, HOME a file": {"PATH": "/usr/bin:/bin", "TERM": None, "HOME": "/dev/null"},
}


@pytest.mark.slow
@pytest.mark.parametrize("title", ENVIRONMENTS)
def test_variables(folder: Path, title: str) -> None:
    judged(folder, f"@ {GOOD}", "right", **ENVIRONMENTS[title])
    judged(folder, f"@ {BAD}", "refused", ("nowhere.toml",), **ENVIRONMENTS[title])


@pytest.mark.slow
def test_a_name_in_another_script(folder: Path) -> None:
    name = "ger\u00e4t-\u732b.toml"
    (folder / "device.toml").rename(folder / name)
    judged(folder, "@ " + GOOD.replace("device.toml", name), "right", LANG="C", LC_ALL="C")
    judged(folder, "@ " + BAD.replace("nowhere.toml", f"no-{name}"), "refused", ("no-ger",), **ASCII)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("command", "closed", "status"),
    [
        (GOOD, ">&-", 0),
        ("--help", ">&-", 0),
        (BAD, "2>&-", 2),
        (GOOD, "<&- >&- 2>&-", 0),
    ],
)
def test_closed_streams(folder: Path, command: str, closed: str, status: int) -> None:
    outcome = run(f"@ {command} {closed}", folder)
    assert outcome.status == status, outcome.err
    assert "Traceback" not in outcome.out + outcome.err


@pytest.mark.slow
@pytest.mark.parametrize(("command", "full"), [(BAD, "2>/dev/full"), (GOOD, ">/dev/full"), ("--help", ">/dev/full")])
def test_full_streams(folder: Path, command: str, full: str) -> None:
    outcome = run(f"@ {command} {full}", folder)
    assert outcome.status in (0, 2), outcome.err
    assert "Traceback" not in outcome.out + outcome.err
    assert all(line.startswith(PROGRAM) for line in outcome.err.splitlines())


@pytest.mark.slow
def test_a_reader_that_has_seen_enough(folder: Path) -> None:
    assert run("set -o pipefail; @ --help | head -1", folder).err == ""
    assert "Traceback" not in run(f"@ {GOOD} | true", folder).err


@pytest.fixture
def read_only(folder: Path) -> Iterator[Any]:
    """The folder, without the right to write; for root such a folder is made by a mount where that is allowed."""
    if os.geteuid() != 0:
        folder.chmod(0o555)
        yield folder, ""
        folder.chmod(0o755)
        return
    mount = f"mount --bind {folder} {folder} && mount -o remount,bind,ro {folder} && cd {folder} && "
    if not shutil.which("unshare") or run(f"unshare -m bash -c '{mount} true'", folder).status:
        pytest.skip("root may write everywhere, and this machine allows no mount of a read-only folder.")
    yield folder, mount


@pytest.mark.slow
@pytest.mark.parametrize("command", [GOOD, "trace device.toml"])
def test_a_read_only_folder(read_only: Any, command: str) -> None:
    folder, mount = read_only
    words = f"unshare -m bash -c '{mount} @ {command}'" if mount else f"@ {command}"
    judged(folder, words, "refused", ("out",))


@pytest.mark.slow
def test_a_folder_that_was_removed(folder: Path) -> None:
    outcome = run(f"mkdir gone && cd gone && rmdir ../gone && @ {BAD}", folder)
    assert outcome.status == 2
    assert "Traceback" not in outcome.err


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read every file")
def test_a_file_without_permission(folder: Path) -> None:
    (folder / "device.toml").chmod(0)
    judged(folder, f"@ {GOOD}", "refused", ("device.toml",))


@pytest.mark.slow
@pytest.mark.parametrize("limit", ["-n 40", "-f 0", "-u 60"])
def test_limits_of_the_system(folder: Path, limit: str) -> None:
    outcome = run(f"ulimit {limit}; @ {GOOD}", folder)
    assert outcome.status in (0, 2), f"{outcome.status} {outcome.err}"
    assert "Traceback" not in outcome.out + outcome.err
    assert not [name for name in snapshot(folder) if Path(name).name.startswith(".")]


def test_the_program_starts_from_everywhere(tmp_path: Path) -> None:
    assert run("@ --version", tmp_path).status == 0
