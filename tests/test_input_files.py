import gzip
import os
import socket
import zlib
from pathlib import Path
from socket import gaierror
from typing import NoReturn

import cv2
import numpy as np
import pytest

from wlr_render import cli
from wlr_render.errors import BadInputError
from wlr_render.io import input_files
from wlr_render.io.input_files import prefix_errors

WHOLE = 1_000_000


def test_only_regular_files_are_read(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", "/dev/zero"):
        with pytest.raises(BadInputError, match="is a pipe or a device"):
            input_files.read_bytes(path, WHOLE)
    with pytest.raises(BadInputError, match="is a folder"):
        input_files.read_bytes(tmp_path, WHOLE)
    with pytest.raises(BadInputError, match="no such file"):
        input_files.read_bytes(tmp_path / "none", WHOLE)
    with pytest.raises(BadInputError, match="cannot be read"):
        input_files.read_bytes("a\0b", WHOLE)


def test_a_file_has_a_largest_size(tmp_path: Path) -> None:
    path = tmp_path / "large"
    path.write_bytes(bytes(10))
    assert input_files.read_bytes(path, 10) == bytes(10)
    with pytest.raises(BadInputError, match=r"large: has more than 9e-06 MB"):
        input_files.read_bytes(path, 9)


def test_text_that_is_not_utf_8_is_refused_by_its_line(tmp_path: Path) -> None:
    path = tmp_path / "text"
    path.write_bytes(b"\xef\xbb\xbfa\nb\xff")
    with pytest.raises(BadInputError, match="line 2 is not UTF-8 text, so this is not a poem"):
        input_files.read_text(path, "a poem")
    path.write_bytes(b"\xef\xbb\xbfa")
    assert input_files.read_text(path, "a poem") == "a"


def test_gzip_is_decompressed_up_to_its_limit() -> None:
    packed = gzip.compress(bytes(1000)) + gzip.compress(b"end")
    assert input_files.gunzip("f", packed, 1003) == bytes(1000) + b"end"
    for content, limit, sentence in (
        (packed, 1002, "decompresses to more than"),
        (packed[:-9], WHOLE, "cut short"),
        (zlib.compress(b"a"), WHOLE, "cannot be read as a gzip file"),
    ):
        with pytest.raises(BadInputError, match=sentence):
            input_files.gunzip("f", content, limit)


def test_arrays_that_decompress_to_too_much_are_refused_unread(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.npz"
    np.savez_compressed(path, a=np.zeros(1000))
    assert input_files.read_arrays(path, "captures")["a"].shape == (1000,)
    monkeypatch.setattr(input_files, "LIMITS", input_files.InputLimits(array_bytes=4000))
    with pytest.raises(BadInputError, match="decompresses to more than"):
        input_files.read_arrays(path, "captures")
    np.savez(path, a=np.array([{}]))
    with pytest.raises(BadInputError, match="cannot be read as captures"):
        input_files.read_arrays(path, "captures")


@pytest.mark.parametrize("suffix", [".png", ".tiff", ".pfm"])
def test_a_picture_of_too_many_pixels_is_refused_undecoded(
    suffix: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / f"a{suffix}"
    cv2.imwrite(str(path), np.zeros((30, 40, 3), np.uint8 if suffix == ".png" else np.float32))
    assert input_files.read_image(path, cv2.IMREAD_UNCHANGED).shape == (30, 40, 3)
    monkeypatch.setattr(input_files, "LIMITS", input_files.InputLimits(picture_pixels=1199))
    with pytest.raises(BadInputError, match="has 40x30 pixels"):
        input_files.read_image(path, cv2.IMREAD_UNCHANGED)


@pytest.mark.parametrize("content", [b"", b"text", cv2.imencode(".hdr", np.ones((4, 6, 3), np.float32))[1].tobytes()])
def test_a_picture_of_unknown_size_is_refused_undecoded(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    path.write_bytes(content)
    with pytest.raises(BadInputError, match=r"a\.png: cannot be read as a picture \(its format is not known\)"):
        input_files.read_image(path, cv2.IMREAD_UNCHANGED)


@pytest.mark.parametrize(
    "error", [KeyError("a"), RecursionError(), MemoryError(), OverflowError("big"), OSError(5, "x")]
)
def test_whatever_a_parser_raises_names_the_file(
    error: KeyError | MemoryError | OSError | OverflowError | RecursionError,
) -> None:
    with (
        pytest.raises(BadInputError, match=r"^thing\.x: .*; write it again\.$"),
        input_files.as_bad_input("thing.x", "a thing"),
    ):
        raise error


def test_work_on_a_file_names_it() -> None:
    with pytest.raises(BadInputError, match=r"^eye\.npz: too few\."), prefix_errors("eye.npz"):
        raise BadInputError("too few.")
    with pytest.raises(BadInputError, match=r"^in eye\.npz\."), prefix_errors("eye.npz"):
        raise BadInputError("in eye.npz.")
    with (
        pytest.raises(BadInputError, match=r"^eye\.npz: the readings do not determine the fit"),
        prefix_errors("eye.npz"),
    ):
        np.linalg.cholesky(-np.eye(2))
    with pytest.raises(ZeroDivisionError), prefix_errors("eye.npz"):
        _ = 1 / 0


def test_a_reference_stays_in_its_folder(tmp_path: Path) -> None:
    folder = tmp_path / "in"
    folder.mkdir()
    (folder / "link").symlink_to(tmp_path)
    assert input_files.inside_folder(folder, "a/../b", "f") == folder / "a/../b"
    for name in ("../b", str(tmp_path / "b"), "link/b"):
        with pytest.raises(BadInputError, match=r"f: .* leads out of the folder"):
            input_files.inside_folder(folder, name, "f")
        with input_files.outside_references():
            assert input_files.inside_folder(folder, name, "f") == folder / name
    with pytest.raises(BadInputError, match="is not the name of a file"):
        input_files.inside_folder(folder, "a\0", "f")


def test_a_length_in_millimetres_is_asked_about() -> None:
    input_files.require_length("f 'z_m'", [0.03, -1.0], 1.0)
    with pytest.raises(BadInputError, match=r"f 'z_m' has a length of 30 m, .* in millimetres"):
        input_files.require_length("f 'z_m'", [[30.0]], 1.0)
    with pytest.raises(BadInputError, match="not finite"):
        input_files.require_length("f 'z_m'", float("nan"), 1.0)


@pytest.mark.parametrize(
    ("error", "status", "sentence"),
    [
        (KeyError("width"), 1, "defect of the program: KeyError in test_input_files.py"),
        (MemoryError(), 2, "memory"),
        (ConnectionResetError(104, "Connection reset by peer"), 1, "defect of the program: ConnectionResetError"),
        (socket.gaierror(-2, "Name or service not known"), 1, "defect of the program: gaierror"),
        (ProcessLookupError(3, "No such process"), 1, "defect of the program: ProcessLookupError"),
        (TimeoutError(110, "Connection timed out"), 1, "defect of the program: TimeoutError"),
        (TimeoutError(110, "Connection timed out", "share/a.png"), 2, "share/a.png: cannot be read or written"),
        (OSError(28, "No space left on device"), 2, "A file: cannot be read or written (No space left on device)"),
        (PermissionError(13, "Permission denied", "a.png"), 2, "a.png: cannot be read or written (Permission denied)"),
    ],
)
def test_any_exception_ends_in_one_sentence(
    error: ConnectionResetError
    | KeyError
    | MemoryError
    | OSError
    | PermissionError
    | ProcessLookupError
    | TimeoutError
    | gaierror,
    status: int,
    sentence: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def fail(*_: object) -> NoReturn:
        raise error

    monkeypatch.setattr(cli, "_run", fail)
    assert cli.main(["demo"]) == status
    printed = capsys.readouterr().err
    assert sentence in printed
    assert len(printed.splitlines()) == 1


def test_the_command_line_lets_trusted_files_refer_to_other_folders(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = []

    def run(*_: object) -> int:
        seen.append(input_files.inside_folder("a", "../b", "f"))
        return 0

    monkeypatch.setattr(cli, "_run", run)
    assert cli.main(["demo", "--outside-references"]) == 0
    assert cli.main(["demo"]) == 2
    assert len(seen) == 1
