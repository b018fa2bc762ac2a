"""A code is shown and photographed by a camera's command; the page and the camera are imitated."""

import contextlib
import json
import os
import re
import sys
import threading
import time
import urllib.request
from pathlib import Path
from typing import Any, cast

import cv2
import numpy as np
import pytest
from present import present

from wlr_render.captures.patterns.catalogue import make_pattern
from wlr_render.captures.photograph_format import PhotographFormat
from wlr_render.captures.photographs import photographs_in, read_photograph
from wlr_render.errors import BadInputError
from wlr_render.jobs.options import Code
from wlr_render.jobs.show_pattern import PatternOptions, pattern
from wlr_render.mappings import Panel
from wlr_render.work.progress import Progress

PANEL = Panel(8, 4)
CODE = make_pattern("gray", PANEL)


class ImitatedPage(Progress):
    """Opens the page that the job names, and puts each picture that it shows into a file, the screen."""

    def __init__(self, screen: Path) -> None:
        self.screen = screen
        self.shown: list[int] = []

    def say(self, text: str) -> None:
        url = present(re.search(r"http://\S+/", text)).group(0)
        threading.Thread(target=self._run, args=(url,), daemon=True).start()

    def _run(self, url: str) -> None:
        with contextlib.suppress(OSError):  # the job has ended
            self._poll(url)

    def _poll(self, url: str) -> None:
        with urllib.request.urlopen(url) as answer:
            root = answer.url.rsplit("/", 1)[0]
        number = -1
        while number < len(CODE.names()):
            with urllib.request.urlopen(f"{root}/state?shown={number}&width=8&height=4") as answer:
                wanted = json.load(answer)["show"]
            if wanted != number:
                self._show(root, wanted)
            number = wanted
            time.sleep(0.01)

    def _show(self, root: str, number: int) -> None:
        if 0 <= number < len(CODE.names()):
            name = f"{number:03d}_{CODE.names()[number].replace(' ', '_')}.png"
            with urllib.request.urlopen(f"{root}/{name}") as answer:
                self.screen.write_bytes(answer.read())
            self.shown.append(number)


@pytest.fixture
def camera(tmp_path: Path) -> str:
    """A camera's program: copies the screen, and fails while there is a file `flat_battery`."""
    program = tmp_path / "camera.py"
    program.write_text(
        "import sys, shutil, pathlib\n"
        f"here = pathlib.Path({str(tmp_path)!r})\n"
        "if (here / 'flat_battery').exists() and '004' in sys.argv[1]: sys.exit('the battery is flat')\n"
        "shutil.copy(here / 'screen', sys.argv[1])\n"
    )
    return f"{sys.executable} -S -E {program} {{path}}"


def options(tmp_path: Path, camera: str, **others: Any) -> PatternOptions:
    given = {"panel": (8, 4), "pattern": "gray", "port": 0, "settle_s": 0.0, "page_timeout_s": 20.0, **others}
    return PatternOptions(out=tmp_path / "display" / "00", photograph=camera, **given)


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("wlr_render.jobs.show_pattern._STABLE_S", 0.02)
    monkeypatch.setattr("wlr_render.jobs.show_pattern._LOOK_S", 0.01)


@pytest.mark.slow
@pytest.mark.usefixtures("quick")
def test_the_photographs_are_those_of_the_code_and_an_interrupted_capture_continues(
    tmp_path: Path, camera: str
) -> None:
    (tmp_path / "flat_battery").touch()
    page, given = ImitatedPage(tmp_path / "screen"), options(tmp_path, camera)
    with pytest.raises(BadInputError, match=r"004_.*failed with status 1 \(the battery is flat\)"):
        pattern(given, progress=page)
    assert page.shown == [0, 1, 2, 3, 4]
    os.remove(tmp_path / "flat_battery")

    page = ImitatedPage(tmp_path / "screen")
    report = pattern(given, progress=page)
    count = len(CODE.names())
    assert report.verdict.startswith(f"{count - 4} photographs taken, 4 kept from an earlier run")
    assert page.shown == list(range(4, count))
    paths = photographs_in(given.out)
    assert len(paths) == count
    for number, path in enumerate(paths):
        assert np.array_equal(read_photograph(path, PhotographFormat(8, synthetic=True)), CODE.image(number))
    assert pattern(given, progress=page).verdict.startswith(f"0 photographs taken, {count} kept")

    whole = paths[2].read_bytes()
    paths[2].write_bytes(whole[:-10])
    page = ImitatedPage(tmp_path / "screen")
    report = pattern(given, progress=page)
    assert page.shown == [2]
    assert paths[2].read_bytes() == whole
    assert report.warnings == [f"{paths[2]}: this photograph, one of 1, had changed; they were taken again."]

    with pytest.raises(BadInputError, match="belongs to other options: --channel was None and is red; choose another"):
        pattern(options(tmp_path, camera, channel="red"))
    with pytest.raises(
        BadInputError, match="belongs to other options: job was pattern --photograph and is pattern; choose"
    ):
        pattern(PatternOptions(panel=(8, 4), out=given.out))
    (given.out / "finished.jsonl").unlink()
    with pytest.raises(BadInputError, match=r"000_white\.png: was written by another program"):
        pattern(given)
    assert paths[2].read_bytes() == whole


@pytest.mark.slow
@pytest.mark.usefixtures("quick")
def test_a_primary_alone(tmp_path: Path, camera: str) -> None:
    given = options(tmp_path, camera, channel="red")
    pattern(given, progress=ImitatedPage(tmp_path / "screen"))
    white = cv2.imread(str(given.out / "000_white.png"), cv2.IMREAD_UNCHANGED)
    assert white is not None
    assert white.reshape(-1, 3).tolist() == [[0, 0, 255]] * white[..., 0].size


def test_what_cannot_be_captured_is_refused_first(tmp_path: Path, camera: str) -> None:
    given = options(tmp_path, camera)
    given.out.mkdir(parents=True)
    (given.out / "holiday.jpg").touch()
    with pytest.raises(BadInputError, match=r"contains holiday\.jpg, which does not belong to this code"):
        pattern(given)
    with pytest.raises(BadInputError, match=r"lacks \{path\}"):
        pattern(options(tmp_path, "gphoto2"))


def test_a_page_that_nobody_opens(tmp_path: Path, camera: str) -> None:
    with pytest.raises(BadInputError, match=r"no page asked for a picture; open http://127.0.0.1:"):
        pattern(options(tmp_path, camera, page_timeout_s=0.2))
    assert not (tmp_path / "display" / "00").exists()


def test_the_pictures_of_a_code_are_written_in_the_order_of_showing(tmp_path: Path) -> None:
    report = pattern(PatternOptions(panel=(64, 40), pattern="gray", out=tmp_path))
    (page,) = report.files
    code = make_pattern("gray", Panel(64, 40))
    written = photographs_in(page.parent)
    assert report.verdict.startswith(f"{len(written)} pictures")
    assert len(written) == len(code.names())
    for number, path in enumerate(written):
        assert np.array_equal(read_photograph(path), code.image(number))
    assert page.is_file()


def test_what_cannot_be_shown_is_refused_and_nothing_written(tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match="--pattern is grey; choose from gray"):
        pattern(PatternOptions(panel=(64, 40), pattern=cast(Code, "grey"), out=tmp_path / "a"))
    with pytest.raises(
        BadInputError, match="--port is used with --photograph only; leave it out, or give --photograph"
    ):
        PatternOptions(panel=(64, 40), port=1)
    assert list(tmp_path.iterdir()) == []
