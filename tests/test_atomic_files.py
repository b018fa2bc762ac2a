import math
import os
import re
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from present import present

from wlr_render.captures.boards.board_drawing import write_board_svg
from wlr_render.captures.boards.chessboard import Chessboard
from wlr_render.captures.photographs import write_photograph
from wlr_render.captures.session_schema import DISPLAY
from wlr_render.captures.session_tables import write_table
from wlr_render.errors import BadInputError
from wlr_render.io import atomic_files, toml_files
from wlr_render.io.toml_files import Table
from wlr_render.report.blocks import Report
from wlr_render.report.html import html_page
from wlr_render.report.plots import curves
from wlr_render.report.provenance import provenance
from wlr_render.scene import image_files


def table(tmp_path: Path, text: str) -> Table:
    path = tmp_path / "thing.toml"
    path.write_text(text)
    return toml_files.read_toml(path)


def test_output_appears_whole_or_not_at_all(tmp_path: Path) -> None:
    target = tmp_path / "deep" / "result.txt"
    atomic_files.write_text(target, "old")

    def fail_half_way() -> None:
        with atomic_files.written_whole(target) as temporary:
            temporary.write_text("half")
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail_half_way()
    assert target.read_text() == "old"
    assert [p.name for p in target.parent.iterdir()] == ["result.txt"]


def test_an_output_folder_that_is_a_file_is_refused_by_name(tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("")
    with pytest.raises(BadInputError, match=r"taken.*choose another"):
        atomic_files.output_folder(tmp_path / "taken")


def test_unknown_name_lists_what_is_shipped(tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match=r"neither a file nor one of the shipped devices"):
        atomic_files.named_or_path("devices", "northstart")
    for name in ("none.toml", "a\0.toml", 300 * "a" + ".toml"):
        with pytest.raises(BadInputError, match="no such file"):
            atomic_files.named_or_path("devices", tmp_path / name)
    with pytest.raises(BadInputError, match=r": is a folder; name a file in it"):
        atomic_files.named_or_path("devices", tmp_path)
    (tmp_path / "model.json").write_text("{}")
    with pytest.raises(BadInputError, match=r": is a folder; name .*model\.json\."):
        atomic_files.named_or_path("devices", tmp_path)


def test_a_file_of_the_current_folder_is_found_whatever_its_suffix(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine").write_text("")
    assert atomic_files.named_or_path("devices", "mine") == Path("mine")
    (tmp_path / "northstar").write_text("")
    assert atomic_files.named_or_path("devices", "northstar").is_absolute()  # a shipped name comes first


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("a_mm = 'x'", r"thing.toml: 'a_mm' must be a number"),
        ("a_mm = nan", r"'a_mm' must be finite"),
        ("a_mm = true", r"'a_mm' must be a number"),
        ("a_m = 1", r"key 'a_mm' is missing \(found 'a_m' instead\)"),
        ("a_mm = 1\nb = 2", r"unknown key 'b'; remove it"),
        ("a_mm = 1\na_cm = 2", r"unknown key 'a_cm'; remove it"),
        ("\na_mm = =", r"cannot be read as a TOML file .*line 2"),
        ("a_mm = 1" + 400 * "0", r"'a_mm' must be finite and below 1e\+18, not 1000.*\.\.\..*0\.$"),
        ("a_mm = 0x1" + 4000 * "0", r"'a_mm' must be finite and below 1e\+18, not a large int"),
        ("a_mm = -1e308", r"'a_mm' must be finite and below 1e\+18, not -1e\+308"),
        ("a_mm = '" + 9000 * "x" + "'", r"'a_mm' must be a number, not 'x{20,60}\.\.\.x{20,60}'\.$"),
        ("a_mm = " + 9000 * "[", "is nested too deeply to be a TOML file"),
        (9000 * "a." + "a = 1", "a key of 50 parts or more at line 1"),
        ("a_mm = 1\n" + 9000 * "b" + " = 2", r"unknown key 'b{20,60}\.\.\.b{20,60}'; remove it\.$"),
        ("a_mm = 1\n'\\u001b[2K' = 2", r"unknown key '\\\\u001b\[2K'"),
    ],
)
def test_each_fault_in_a_toml_file_gets_one_sentence(tmp_path: Path, text: str, sentence: str) -> None:
    with pytest.raises(BadInputError, match=sentence):
        read_a(tmp_path, text)


@pytest.mark.parametrize(
    ("key", "remedy"), [("eye", "remove it."), ("eye_bx", "did you mean 'eye_box'?"), ("eye_box_mm", "did you mean")]
)
def test_only_near_spellings_of_a_key_are_suggested(key: str, remedy: str) -> None:
    given = Table({key: 1}, "thing.toml")
    assert not given.has("eye_box")
    with pytest.raises(BadInputError, match=f"unknown key '{key}'; {re.escape(remedy)}"):
        given.finish()
    found = "" if key == "eye" else rf" \(found '{key}' instead\)"
    with pytest.raises(BadInputError, match=f"^thing.toml: key 'eye_box' is missing{found}; write it"):
        given.number("eye_box")


@pytest.mark.parametrize(
    ("key", "other"),
    [
        ("u_axis", "v_axis"),
        ("aperture_x_mm", "aperture_y_mm"),
        ("aperture_x_m", "aperture_y_mm"),
        ("camera_qx", "camera_qw"),
    ],
)
def test_no_key_is_suggested_for_that_of_another_axis(key: str, other: str) -> None:
    given = Table({key: 1}, "thing.toml")
    assert not given.has(other)
    with pytest.raises(BadInputError, match=f"unknown key '{key}'; remove it"):
        given.finish()
    with pytest.raises(BadInputError, match=f"key '{other}' is missing; write it"):
        given.number(other)


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        ('{"a": 1, "a": 2}', r"cannot be read as a thing \(key 'a' is there twice\); write it again"),
        ('{"a": NaN}', "'a' must be finite"),
        ('{"a": -Infinity}', "'a' must be finite"),
        ('{"a": 1e999}', "'a' must be finite"),
        ('{"a": 1' + 9000 * "0" + "}", "cannot be read as a thing"),
        (90_000 * "[", "is nested too deeply to be a thing"),
        ("[1]", "is not a thing"),
        ('{"a": 1}'.encode("utf-16"), "line 1 is not UTF-8 text"),
        (b'\xef\xbb\xbf{"a": 1', "cannot be read as a thing"),
    ],
)
def test_each_fault_in_a_json_file_gets_one_sentence(tmp_path: Path, content: bytes | str, sentence: str) -> None:
    path = tmp_path / "thing.json"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(BadInputError, match=rf"^{re.escape(str(path))}: .*{sentence}"):
        toml_files.read_json(path, "a thing").number("a")


def read_a(tmp_path: Path, text: str) -> None:
    content = table(tmp_path, text)
    assert content.number("a_mm") == 1
    content.finish()


def test_readers_of_every_kind(tmp_path: Path) -> None:
    content = table(tmp_path, 'v = [1, 2]\nt = "x"\nf = true\n[s]\nk = 1\n[[r]]\nk = 2\n[[r]]\nk = 3')
    assert content.vector("v", 2).tolist() == [1, 2]
    assert content.text("t", choices=["x"]) == "x"
    assert content.flag("f", False)
    assert content.table("s").number("k") == 1
    assert [row.number("k") for row in content.tables("r")] == [2, 3]
    content.finish()
    with pytest.raises(BadInputError, match=r"list of 3 numbers"):
        content.vector("v", 3)
    with pytest.raises(BadInputError, match=r"one of y"):
        content.text("t", choices=["y"])
    with pytest.raises(BadInputError, match=r"\[\[r\]\] number 2: key 'q' is missing"):
        content.tables("r")[1].number("q")


def test_written_toml_is_read_back_to_the_last_bit(tmp_path: Path) -> None:
    """Values of every kind, headers in headers, and plain values given after tables."""
    content = {
        "inner": {"deep": {"k": 1}, "after": 0.1},
        "rows": [{"name": "a", "cells": [{"v": 1e-300}, {"v": -2}]}, {"name": "b", "sub": {"flag": False}}, {}],
        "text": 'quote " slash \\ line\n tab\t bell\a delete\x7f umlaut \u00fc beyond \U0001f576',
        "odd key.": True,
        "texts": ["[\n1,\n2,\n]", "a, b", "[", "1,"],
        "floats": [math.pi, -0.0, 1e16, 5e-324, 1.7976931348623157e308],
        "matrix": [[1.0, 2.0], [3.0, 4.0]],
        "none": [],
        "empty": {},
    }
    path = toml_files.write_toml(tmp_path / "deep" / "thing.toml", content, comment="two\nlines = 3")
    assert path.read_text().startswith("# two\n# lines = 3\n")
    back = tomllib.loads(path.read_text(encoding="utf-8"))
    assert back == content
    assert math.copysign(1, back["floats"][1]) == -1


def test_written_vectors_are_on_one_line_each(tmp_path: Path) -> None:
    content = {"v": [1.0, -2.5e-7, 3], "rows": [[1.0, 2.0], [3.0, 4.0]], "table": [{"at": [0.5, 1.0], "on": True}]}
    assert toml_files.write_toml(tmp_path / "thing.toml", content).read_text().splitlines() == [
        "v = [1.0, -2.5e-07, 3]",
        "rows = [",
        "    [1.0, 2.0],",
        "    [3.0, 4.0],",
        "]",
        "",
        "[[table]]",
        "at = [0.5, 1.0]",
        "on = true",
    ]


def test_arrays_and_their_numbers_are_written_as_plain_ones(tmp_path: Path) -> None:
    content = {"v": np.array([[0.1, 2.0]]), "n": np.int64(3), "x": np.float64(0.3), "b": np.bool_(True)}
    back = tomllib.loads(toml_files.write_toml(tmp_path / "thing.toml", content).read_text())
    assert back == {"v": [[0.1, 2.0]], "n": 3, "x": 0.3, "b": True}


@pytest.mark.parametrize("value", [math.nan, np.inf, None, [1.0, np.nan], [{"a": 1}, 2]])
def test_what_toml_cannot_hold_is_refused_and_no_file_appears(
    tmp_path: Path, value: Sequence[dict[str, int] | float] | float | None
) -> None:
    with pytest.raises(ValueError, match=r"'outer\.key' cannot be written as TOML"):
        toml_files.write_toml(tmp_path / "thing.toml", {"outer": {"key": value}})
    assert not list(tmp_path.iterdir())


_BOARD = Chessboard(12, 9, 0.03, 0.0)
_REPORT = Report("Noise", blocks=[curves("noise", {"a": (range(200), range(200))}, ("x", "y"))])
_ORIGIN = provenance(_REPORT, Path())
_COLUMNS = {column.name: np.arange(2000.0) for column in DISPLAY.columns}
_NOISE = np.random.default_rng(0).integers(0, 256, (90, 120, 3), np.uint8)


def _figure() -> Figure:
    figure = Figure()
    figure.subplots().imshow(_NOISE)
    return figure


WRITERS = {
    "a.txt": lambda path: atomic_files.write_text(path, "x" * 5000),
    "a.npz": lambda path: atomic_files.write_arrays(path, {"noise": _NOISE}),
    "figure.png": lambda path: atomic_files.write_figure(path, _figure()),
    "a.png": lambda path: image_files.write_png(path, _NOISE),
    "a.tiff": lambda path: image_files.write_map(path, _NOISE.astype(np.float32)),
    "a.pfm": lambda path: image_files.write_map(path, _NOISE.astype(np.float32)),
    "a.tif": lambda path: write_photograph(path, _NOISE[..., 0]),
    "a.json": lambda path: toml_files.write_json(path, {"values": _NOISE.ravel().tolist()}),
    "a.toml": lambda path: toml_files.write_toml(path, {"rows": _NOISE[:9].tolist()}),
    "report.html": lambda path: atomic_files.write_text(path, html_page(_REPORT, _ORIGIN)),
    "board.svg": lambda path: write_board_svg(_BOARD, path),
    "drawing.pdf": lambda path: atomic_files.write_figure(path, _figure()),
    "a.csv.gz": lambda path: write_table(path, DISPLAY, _COLUMNS),
    "a.mp4": lambda path: image_files.write_video(path, [_NOISE, _NOISE[::-1].copy()], 30.0),
}


@pytest.mark.parametrize("name", WRITERS)
def test_on_a_full_disk_no_output_appears_and_the_old_one_stays(
    tmp_path: Path, file_size_limit: Callable[[int], AbstractContextManager[None]], name: str
) -> None:
    target = tmp_path / name
    target.write_text("old")
    full = pytest.raises(BadInputError, match=rf"{name}: .*free space.* or choose another folder")
    with file_size_limit(4096), full:
        WRITERS[name](target)
    assert [path.name for path in tmp_path.iterdir()] == [name]
    assert target.read_text() == "old"


def test_outputs_have_the_permissions_that_the_umask_gives_and_leave_the_umask_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plain = tmp_path / "plain"
    plain.write_text("")
    monkeypatch.setattr(os, "umask", lambda mask: pytest.fail("another thread's files would get this umask"))
    assert atomic_files.write_text(tmp_path / "ours", "").stat().st_mode == plain.stat().st_mode


def test_on_a_disk_of_any_size_an_output_is_whole_or_the_old_one_stays(tmp_path: Path) -> None:
    """A disk in memory, which this process cannot mount, but one in a namespace of its own can."""
    script = Path(__file__).with_name("full_disk.py")
    run = ["unshare", "--map-root-user", "--mount"]
    if not shutil.which("unshare") or subprocess.run([*run, "true"], capture_output=True).returncode:
        pytest.skip("no user namespaces here: a disk of another size cannot be mounted")
    path = os.pathsep.join([str(script.parent), *sys.path])
    # A PDF has its date in it.
    environment = os.environ | {"PYTHONPATH": path, "SOURCE_DATE_EPOCH": "0"}
    command = [*run, sys.executable, str(script), str(tmp_path)]
    result = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert (result.returncode, result.stdout) == (0, ""), result.stderr
    assert result.stderr.count("refused") == len(WRITERS), result.stderr


ABANDONED = """
import os, signal, sys
from wlr_render.io import atomic_files
with atomic_files.locked_folder(sys.argv[1], "a killed run"), atomic_files.written_whole(sys.argv[1] + "/a.png"):
    print("ready", flush=True)
    signal.pause()
"""


@pytest.fixture
def other_run(tmp_path: Path) -> Iterator[Any]:
    """A process that is writing a file into a folder that it has locked."""
    pytest.importorskip("fcntl")
    run = subprocess.Popen([sys.executable, "-c", ABANDONED, tmp_path], stdout=subprocess.PIPE, text=True)
    assert present(run.stdout).readline() == "ready\n"
    yield run
    run.kill()
    run.communicate()


def test_a_second_run_is_refused_at_once_and_takes_over_from_a_killed_one(tmp_path: Path, other_run: Any) -> None:
    folder = tmp_path
    with pytest.raises(BadInputError, match=rf"a killed run \(process {other_run.pid}\) is writing"):
        atomic_files.locked_folder(folder, "ours").__enter__()
    atomic_files.write_text(folder / "b.txt", "b")
    assert len([path for path in folder.iterdir() if path.name.startswith(".wlr-")]) == 2, "of the run that goes on"
    other_run.kill()
    other_run.wait()
    atomic_files.remove_abandoned_once.cache_clear()  # as in a new process
    with atomic_files.locked_folder(folder, "ours"):
        assert (folder / ".wlr-render.lock").read_text() == f"ours (process {os.getpid()})"
        atomic_files.write_text(folder / "b.txt", "b")
        (folder / ".wlr-part-of-a-killed-worker.png").touch()
    assert [path.name for path in folder.iterdir()] == ["b.txt"]


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="makes pipes")
def test_a_lock_that_is_a_link_or_a_pipe_changes_no_other_file_and_is_not_waited_for(tmp_path: Path) -> None:
    folder, victim = tmp_path / "out", tmp_path / "victim"
    folder.mkdir()
    victim.write_text("mine")
    lock = folder / ".wlr-render.lock"
    lock.symlink_to(victim)
    with pytest.raises(BadInputError, match=r"wlr-render\.lock: cannot be written"):
        atomic_files.locked_folder(folder, "ours").__enter__()
    assert victim.read_text() == "mine"
    lock.unlink()
    os.mkfifo(lock)
    with atomic_files.locked_folder(folder, "ours"):
        pass


def test_a_folder_that_a_refused_run_made_is_removed(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError), atomic_files.locked_folder(tmp_path / "deep" / "out", "ours"):
        raise RuntimeError
    assert not list(tmp_path.iterdir())
