"""Libraries print warnings of their own: the user of a verb does not see them, except with --debug."""

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from wlr_render.cli import main
from wlr_render.errors import BadInputError
from wlr_render.library_output import silenced_libraries

CHATTER = """
import contextlib, logging, os, sys, warnings
from wlr_render.library_output import silenced_libraries
with BLOCK():
    os.write(2, b"C library\\n")
    warnings.warn("warning")
    logging.getLogger("trimesh").warning("log")
    print("our own sentence", file=sys.stderr)
print("afterwards", file=sys.stderr)
os.write(2, b"C library again\\n")
"""


def printed_by(block: str, **how: Any) -> Any:
    code = CHATTER.replace("BLOCK", block)
    return subprocess.run([sys.executable, "-c", code], stderr=subprocess.PIPE, text=True, check=True, **how).stderr


def test_only_our_own_sentences_come_through() -> None:
    assert printed_by("silenced_libraries") == "our own sentence\nafterwards\nC library again\n"
    assert {"C library", "log", "our own sentence"} < set(printed_by("contextlib.nullcontext").splitlines())


def test_standard_error_comes_back_after_an_error(capfd: pytest.CaptureFixture[str]) -> None:
    stream = sys.stderr
    with pytest.raises(ZeroDivisionError), silenced_libraries():
        raise ZeroDivisionError
    os.write(2, b"seen\n")
    assert sys.stderr is stream
    assert capfd.readouterr().err == "seen\n"


def test_a_closed_standard_error_is_no_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    kept = os.dup(2)
    monkeypatch.setattr(sys, "stderr", None)
    os.close(2)
    try:
        with silenced_libraries():
            pass
    finally:
        os.dup2(kept, 2)
        os.close(kept)


def test_a_damaged_picture_ends_in_one_sentence(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    png = cv2.imencode(".png", np.random.default_rng(0).integers(0, 255, (90, 120, 3), np.uint8))[1].tobytes()
    for number in range(18):
        (tmp_path / f"{number:02d}.png").write_bytes(png[:9000])
    arguments = ["decode", str(tmp_path), "--panel", "16x16", "--out", str(tmp_path / "out")]
    assert main(arguments) == 2
    assert len(capfd.readouterr().err.splitlines()) == 1
    with pytest.raises(BadInputError):
        main([*arguments, "--debug"])
    assert "libpng" in capfd.readouterr().err
