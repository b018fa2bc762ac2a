"""Sets of code photographs of a session: several exposures, and sets without the picture of a white panel."""

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from small_photo_session import in_this_process

from wlr_render.captures import session_reading
from wlr_render.captures.boards.board_design import design_board
from wlr_render.captures.decoded import DecodeOptions
from wlr_render.captures.patterns.catalogue import make_pattern
from wlr_render.captures.photo_session import CodeSet, PhotoSession, SessionCamera, SessionPanel
from wlr_render.captures.photograph_format import PhotographFormat
from wlr_render.captures.session_reading import Reading
from wlr_render.mappings import EyeBox, Panel

PATTERN = make_pattern("gray", Panel(64, 48))
BRACKETS = {"1ms": 0.005, "8ms": 0.04, "64ms": 0.32}


@pytest.fixture
def read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[], Reading]:
    """Read the folder "set" of a session of nothing else."""
    monkeypatch.setattr(session_reading, "as_finished", in_this_process)

    def reading() -> Reading:
        session = PhotoSession(
            folder=tmp_path,
            device="headset",
            eyes=("right",),
            eye_boxes={"right": EyeBox(np.zeros(3), np.full(3, 0.01))},
            panels={"right": SessionPanel(PATTERN)},
            decoding=DecodeOptions(),
            board=design_board(8, 6, 0.03),
            eyeball_camera=SessionCamera((232, 184), PhotographFormat(8)),
            display=(CodeSet(tmp_path / "set"),),
        )
        return session_reading.read_session(session, tmp_path / "kept")

    return reading


def photograph(folder: Path, gain: float, offset: float = 1.0) -> None:
    """Every picture of the code by a camera before the panel."""
    folder.mkdir(parents=True)
    for number, name in enumerate(PATTERN.names()):
        shown = np.pad(cv2.resize(PATTERN.image(number), (192, 144), interpolation=cv2.INTER_NEAREST), 20)
        grey = np.clip(np.rint(shown * gain + offset), 0, 255).astype(np.uint8)
        cv2.imwrite(str(folder / f"{number:03d}_{name.replace(' ', '_')}.png"), grey)


def test_a_bracketed_set_is_read_although_its_shortest_exposure_is_black(
    read: Callable[[], Reading], tmp_path: Path
) -> None:
    for name, gain in BRACKETS.items():
        photograph(tmp_path / "set" / name, gain)
    found = read()
    assert not found.excluded
    (panel,) = found.panels.values()
    assert panel.extent == pytest.approx(np.array([[0, 0], [64, 48]]), abs=2.0)


def test_a_bracketed_set_is_read_although_its_longest_exposure_is_blown_out(
    read: Callable[[], Reading], tmp_path: Path
) -> None:
    photograph(tmp_path / "set" / "1ms", 0.5)
    photograph(tmp_path / "set" / "64ms", 32.0, 255.0)
    assert not read().excluded


@pytest.mark.parametrize(("gain", "offset", "why"), [(0.002, 0.0, "black"), (40.0, 255.0, "blown out")])
def test_a_bracketed_set_is_named_where_all_of_its_exposures_are_of_no_use(
    read: Callable[[], Reading], tmp_path: Path, gain: float, offset: float, why: str
) -> None:
    for name in ("1ms", "8ms"):
        photograph(tmp_path / "set" / name, gain, offset)
    (excluded,) = read().excluded
    assert excluded.name == "set"
    assert excluded.reason == f"8ms/000_white.png: is {why}; nothing can be found in it"


def test_a_set_without_white_is_not_judged_by_its_black_picture(read: Callable[[], Reading], tmp_path: Path) -> None:
    photograph(tmp_path / "set", 0.6)
    (tmp_path / "set" / "000_white.png").unlink()
    found = read()
    assert not found.excluded
    assert next(iter(found.panels.values())).missing == ("white",)


def test_a_reading_and_the_one_kept_of_it_are_the_same(read: Callable[[], Reading], tmp_path: Path) -> None:
    photograph(tmp_path / "set", 0.6)
    first = read()
    again = read()
    assert (first.kept, again.kept) == (0, 1)
    (now,), (kept,) = first.panels.values(), again.panels.values()
    for name, value in vars(now.samples).items():
        np.testing.assert_array_equal(value, getattr(kept.samples, name))
    np.testing.assert_array_equal(now.fates, kept.fates)
    assert (now.missing, now.file_note) == (kept.missing, kept.file_note)


def test_a_reading_is_used_whether_or_not_its_file_can_be_read_back(
    read: Callable[[], Reading], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    photograph(tmp_path / "set", 0.6)
    monkeypatch.setattr(session_reading, "write_arrays", lambda *_: None)
    assert len(read().panels) == 1
