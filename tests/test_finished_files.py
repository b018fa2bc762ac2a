"""The list of finished files: what counts as finished, and lists that are damaged, hostile, or on a full disk."""

import json
import os

import pytest

from wlr_render.errors import BadInputError
from wlr_render.io.finished_files import LIST, FinishedFiles, digest_of


@pytest.fixture
def paths(tmp_path):
    """Three files, one of them in a folder of its own."""
    (tmp_path / "display").mkdir()
    found = [tmp_path / "a.png", tmp_path / "b.png", tmp_path / "display" / "a.png"]
    for number, path in enumerate(found):
        path.write_bytes(bytes([number] * 100))
    return found


def test_a_file_is_finished_that_is_as_it_is_listed(tmp_path, paths):
    FinishedFiles(tmp_path).add(paths[:2])
    assert FinishedFiles(tmp_path).missing_or_changed(paths) == [paths[2]]
    assert FinishedFiles(tmp_path).changed(paths) == []
    paths[0].write_bytes(b"other")
    paths[1].unlink()
    finished = FinishedFiles(tmp_path)
    assert (finished.missing_or_changed(paths), finished.changed(paths)) == (paths, [paths[0]])
    finished.add([paths[0]])
    assert FinishedFiles(tmp_path).missing_or_changed(paths) == paths[1:]


def test_files_of_another_job_are_refused(tmp_path, paths):
    one, other = digest_of("gray", (8, 4)), digest_of("gray", (8, 5))
    FinishedFiles(tmp_path, one).add(paths)
    assert FinishedFiles(tmp_path, one).missing_or_changed(paths) == []
    for job in (other, ""):
        with pytest.raises(BadInputError, match=rf"{LIST}: lists files of other options or inputs; choose another"):
            FinishedFiles(tmp_path, job)


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
def test_a_file_whose_line_is_damaged_is_unfinished(tmp_path, paths, line):
    FinishedFiles(tmp_path).add(paths)
    with (tmp_path / LIST).open("ab") as file:
        file.write(b'{"file": "a.png", "bytes": 7, "sha256": ""}\n' + line)
    finished = FinishedFiles(tmp_path)
    assert finished.missing_or_changed(paths) == [paths[0]]
    finished.add([paths[0]])  # begins a new line
    assert FinishedFiles(tmp_path).missing_or_changed(paths) == []


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="makes pipes")
def test_pipes_links_and_huge_lists_are_refused_and_no_file_outside_is_written(tmp_path, paths, tmp_path_factory):
    with (tmp_path / LIST).open("wb") as file:
        file.truncate(1_000_000_000)
    with pytest.raises(BadInputError, match=rf"{LIST}: has more than 256 MB"):
        FinishedFiles(tmp_path)
    (tmp_path / LIST).unlink()
    os.mkfifo(tmp_path / LIST)
    with pytest.raises(BadInputError, match=rf"{LIST}: is a pipe .*; choose another folder or empty it"):
        FinishedFiles(tmp_path)
    (tmp_path / LIST).unlink()
    victim = tmp_path_factory.mktemp("outside") / "victim"
    victim.write_text("mine\n")
    (tmp_path / LIST).symlink_to(victim)
    with pytest.raises(BadInputError, match=rf"{LIST}: cannot be written"):
        FinishedFiles(tmp_path).add(paths)
    assert victim.read_text() == "mine\n"
    (tmp_path / LIST).unlink()
    FinishedFiles(tmp_path).add(paths)
    paths[0].unlink()
    os.mkfifo(paths[0])
    assert FinishedFiles(tmp_path).changed(paths) == [paths[0]]


@pytest.mark.parametrize("room", [0, 1, 100, 200])
def test_on_a_full_disk_the_list_is_refused_and_the_next_run_goes_on(tmp_path, paths, file_size_limit, room):
    FinishedFiles(tmp_path).add(paths[:1])
    finished = FinishedFiles(tmp_path)
    with file_size_limit((tmp_path / LIST).stat().st_size + room):
        for _ in range(2):
            with pytest.raises(BadInputError, match=rf"{LIST}: cannot be written .*; free space"):
                finished.add(paths[1:] * 2)
    after = FinishedFiles(tmp_path)
    left = after.missing_or_changed(paths)
    assert paths[0] not in left
    assert paths[2] in left
    after.add(left)
    assert FinishedFiles(tmp_path).missing_or_changed(paths) == []
    lines = (tmp_path / LIST).read_text().splitlines()
    assert json.loads(lines[0])["file"] == "a.png"
