"""The ledger of finished files: what counts as finished, and ledgers that are damaged, hostile, or on a full disk."""

import json
import os
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import pytest

from wlr_render.errors import BadInputError
from wlr_render.io.kept import LEDGER, Kept, file_of, recipe_of, signatures_of

RECIPE = recipe_of("pattern", {"--pattern": "gray"}, {})


@pytest.fixture
def paths(tmp_path: Path) -> list[Path]:
    """Three files, one of them in a folder of its own."""
    (tmp_path / "display").mkdir()
    found = [tmp_path / "a.png", tmp_path / "b.png", tmp_path / "display" / "a.png"]
    for number, path in enumerate(found):
        path.write_bytes(bytes([number] * 100))
    return found


def test_a_file_is_finished_that_is_as_it_is_listed(tmp_path: Path, paths: list[Path]) -> None:
    Kept(tmp_path, RECIPE).add(signatures_of(paths[:2]))
    assert Kept(tmp_path, RECIPE).unfinished(paths) == [paths[2]]
    assert Kept(tmp_path, RECIPE).changed(paths) == []
    paths[0].write_bytes(b"other")
    paths[1].unlink()
    finished = Kept(tmp_path, RECIPE)
    assert (finished.unfinished(paths), finished.changed(paths)) == (paths, [paths[0]])
    finished.add(signatures_of([paths[0]]))
    assert Kept(tmp_path, RECIPE).unfinished(paths) == paths[1:]


@pytest.mark.parametrize(
    ("job", "options", "inputs", "difference"),
    [
        ("render", {}, {}, "job was pattern and is render"),
        ("pattern", {"--size": [8, 5]}, {}, r"--size was \[8, 4\] and is \[8, 5\]"),
        ("pattern", {"--channel": "red"}, {}, "--channel was None and is red"),
        ("pattern", {"--device": file_of("b.toml", "2")}, {}, "--device was a.toml and is b.toml"),
        ("pattern", {"--device": file_of("a.toml", "2")}, {}, "a.toml has changed"),
        ("pattern", {"--device": None}, {}, "--device was a.toml and is None"),
        ("pattern", {}, {"one.png": "2", "two.png": "1"}, "one.png has changed"),
        ("pattern", {}, {"one.png": "1"}, "two.png has changed"),
    ],
)
def test_files_of_other_options_are_refused_in_one_sentence(
    tmp_path: Path, paths: list[Path], job: str, options: dict[str, Any], inputs: Mapping[str, str], difference: str
) -> None:
    stated = {"--size": (8, 4), "--device": file_of("a.toml", "1")}
    inputs_before = {"one.png": "1", "two.png": "2"}
    Kept(tmp_path, recipe_of("pattern", stated, inputs_before)).add(signatures_of(paths))
    elsewhere = stated | {"--device": file_of("there/a.toml", "1")}
    again = Kept(tmp_path, recipe_of("pattern", elsewhere, {"./one.png": "1", "one.png": "1", "two.png": "2"}))
    assert again.unfinished(paths) == []
    sentence = rf"{tmp_path}: belongs to other options: {difference}; choose another folder or empty it\.$"
    with pytest.raises(BadInputError, match=sentence):
        Kept(tmp_path, recipe_of(job, stated | options, inputs or inputs_before))


def test_files_that_no_ledger_lists_are_refused_unless_the_recipe_was_stated(tmp_path: Path, paths: list[Path]) -> None:
    planned: dict[Path, dict[str, Any]] = {path: {} for path in paths}
    with pytest.raises(BadInputError, match=r"a\.png: was written by another program or job; choose another"):
        Kept(tmp_path, RECIPE, planned)
    (tmp_path / LEDGER).write_text('{"file": "a.png", "bytes": 100, "sha256": ""}\n')
    with pytest.raises(BadInputError, match=rf"other options: {LEDGER} does not state them; choose another folder"):
        Kept(tmp_path, RECIPE, planned)
    (tmp_path / LEDGER).unlink()
    Kept(tmp_path, RECIPE).begin()
    assert Kept(tmp_path, RECIPE, planned).unfinished(paths) == paths


def test_facts_are_those_of_the_last_file(tmp_path: Path, paths: list[Path]) -> None:
    Kept(tmp_path, RECIPE).add(signatures_of(paths), {"time_s": 0.1})
    assert [Kept(tmp_path, RECIPE).facts(path) for path in paths] == [{}, {}, {"time_s": 0.1}]


@pytest.mark.parametrize(
    "line",
    [
        b'{"file": "a.png", "bytes": 1',
        b"[]",
        b"null",
        b"[" * 100_000,
        b'{"file": "a.png", "bytes": 1e400, "sha256": ""}',
        b'{"file": "a.png", "bytes": -1, "sha256": ""}',
        b'{"file": "a.png", "bytes": null, "sha256": ""}',
        b'{"file": "a.png", "bytes": ' + b"9" * 5000 + b', "sha256": ""}',
        b'{"file": "a.png", "bytes": ' + b"9" * 40 + b', "sha256": ""}',
        b"\xff\x00",
    ],
    ids=lambda line: line[:40].decode("latin1"),
)
def test_a_file_whose_line_is_damaged_is_unfinished(tmp_path: Path, paths: list[Path], line: bytes) -> None:
    Kept(tmp_path, RECIPE).add(signatures_of(paths))
    with (tmp_path / LEDGER).open("ab") as file:
        file.write(b'{"file": "a.png", "bytes": 7, "sha256": ""}\n' + line)
    finished = Kept(tmp_path, RECIPE)
    assert finished.unfinished(paths) == [paths[0]]
    finished.add(signatures_of([paths[0]]))  # begins a new line
    assert Kept(tmp_path, RECIPE).unfinished(paths) == []


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="makes pipes")
def test_pipes_links_and_huge_lists_are_refused_and_no_file_outside_is_written(
    tmp_path: Path, paths: list[Path], tmp_path_factory: pytest.TempPathFactory
) -> None:
    with (tmp_path / LEDGER).open("wb") as file:
        file.truncate(1_000_000_000)
    with pytest.raises(BadInputError, match=rf"{LEDGER}: has more than 256 MB"):
        Kept(tmp_path, RECIPE)
    (tmp_path / LEDGER).unlink()
    os.mkfifo(tmp_path / LEDGER)
    with pytest.raises(BadInputError, match=rf"{LEDGER}: is a pipe .*; choose another folder or empty it"):
        Kept(tmp_path, RECIPE)
    (tmp_path / LEDGER).unlink()
    victim = tmp_path_factory.mktemp("outside") / "victim"
    victim.write_text("mine\n")
    (tmp_path / LEDGER).symlink_to(victim)
    with pytest.raises(BadInputError, match=rf"{LEDGER}: cannot be written"):
        Kept(tmp_path, RECIPE).add(signatures_of(paths))
    assert victim.read_text() == "mine\n"
    (tmp_path / LEDGER).unlink()
    Kept(tmp_path, RECIPE).add(signatures_of(paths))
    paths[0].unlink()
    os.mkfifo(paths[0])
    assert Kept(tmp_path, RECIPE).changed(paths) == [paths[0]]


@pytest.mark.parametrize("room", [0, 1, 100, 200])
def test_on_a_full_disk_the_list_is_refused_and_the_next_run_goes_on(
    tmp_path: Path, paths: list[Path], file_size_limit: Callable[[int], AbstractContextManager[None]], room: int
) -> None:
    Kept(tmp_path, RECIPE).add(signatures_of(paths[:1]))
    finished = Kept(tmp_path, RECIPE)
    with file_size_limit((tmp_path / LEDGER).stat().st_size + room):
        for _ in range(2):
            with pytest.raises(BadInputError, match=rf"{LEDGER}: cannot be written .*; free space"):
                finished.add(signatures_of(paths[1:]))
    after = Kept(tmp_path, RECIPE)
    left = after.unfinished(paths)
    assert paths[0] not in left
    assert paths[2] in left
    after.add(signatures_of(left))
    assert Kept(tmp_path, RECIPE).unfinished(paths) == []
    lines = (tmp_path / LEDGER).read_text().splitlines()
    assert json.loads(lines[1])["file"] == "a.png"
