"""session.toml: written and read back the same; each fault is one sentence that names the key."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from captures.test_photo_session_benches import saved, three_axes

from wlr_render.captures.decoded import DecodeOptions
from wlr_render.captures.photo_session import PhotoSession, SessionCamera
from wlr_render.captures.photo_session_file import FILE, load_photo_session
from wlr_render.captures.photograph_format import PhotographFormat
from wlr_render.captures.photographs import write_photograph
from wlr_render.errors import BadInputError


@pytest.fixture
def session(tmp_path: Path) -> PhotoSession:
    """Of three axes, and photographs of the board for the lens of its eyeball camera."""
    lens = [write_photograph(tmp_path / "lens" / f"{k}.png", np.zeros((4, 4), np.uint8)) for k in range(3)]
    camera = SessionCamera((640, 512), PhotographFormat(12), tuple(lens))
    made = replace(three_axes(tmp_path), eyeball_camera=camera, decoding=DecodeOptions(full_scale=4095))
    saved(made)
    return made


def edited(session: PhotoSession, pattern: str, text: str) -> Path:
    path = session.folder / FILE
    old = path.read_text()
    new = re.sub(pattern, text, old, count=1, flags=re.MULTILINE)
    assert new != old, "the edit must hit something"
    path.write_text(new)
    return session.folder


@pytest.mark.parametrize(
    ("pattern", "text", "complaint"),
    [
        ('unit = "mm"', 'unit = "m"', "'unit' is 'm'; a session is in mm"),
        ("size_mm = .*", "size_mm = [0.010, 0.008, 0.006]", r"'size_mm' has the value 0.01; it must be 0.5 or more"),
        (
            "translation_mm = .*",
            "translation_mm = [0.01, 0.04, 0.05]",
            "'translation_mm' .* 0.5 to 1000 mm long",
        ),
        ("stage_mm", "stage_um", "key 'stage_mm' is missing"),
        ("stage_mm = .*", "stage_mm = [1.0, 2.0]", "must be a list of 3 numbers"),
        ("bits = 12", "bits = 7", "'bits' must be a whole number from 8 to 16, not 7"),
        ('eye = "right"', 'eye = "middle"', "must be one of left, right"),
        ('pattern = "gray-fringes"', 'pattern = "grey"', "'pattern' is 'grey'; it must be one of gray, "),
        (
            's0.png"\ntarget_pose = 0',
            's0.png"\ntarget_pose = 3',
            r"\[\[see_through\]\] number 1 is of target pose 3, which has no",
        ),
        ("device = ", "devise = ", "'device' is missing"),
        ("focal_px = .*", "focal_px = [-1.0, 5.0]", "'focal_px' has the value -1; it must be above 0"),
        ('intrinsics = "lens"', 'intrinsics = "lenses"', "there is no such folder"),
        ("rotation = [^=]*]", "rotation = [[2, 0, 0], [0, 1, 0], [0, 0, 1]]", "must be a rotation matrix"),
        ("height_px = 512", "height_px = 1000000000", "has 640x1000000000 pixels, more than"),
        ("width_px = 320", "width_px = 1000000000", "correct 'width_px' and 'height_px'"),
        (
            "centre_mm = .*",
            "centre_mm = [1e9, 0, 0]",
            "'centre_mm' has the value 1e.09; it must be -10000 or more, and at most 10000",
        ),
        ("focal_px = .*", "focal_px = [1e300, 5.0]", "must be finite|the focal length"),
        ("focal_px = .*", "focal_px = [4.2, 4.2]", "not in millimetres"),
        ('"b0.png"', '"../0.png"', r"\[\[bare\]\] number 1: 'photograph': '../0.png' leads out of the folder"),
        ('photographs = "d0"', 'photographs = "/etc"', "'/etc' leads out of the folder"),
        ('board = "board.toml"', 'board = "../board.toml"', "'../board.toml' leads out of the folder"),
        ('intrinsics = "lens"', 'intrinsics = "../lens"', "leads out of the folder"),
        ('intrinsics = "lens"', 'lens_file = "../lens"', "leads out of the folder"),
        (
            "stage_mm = .2.0, 0.0",
            "stage_mm = [2e5, 0.0",
            "'stage_mm' has the value 200000; it must be .* at most 10000",
        ),
        (
            'photographs = "d1"',
            'photographs = "d0"',
            r"\[\[display\]\] 2 is a copy of \[\[display\]\] 1; remove it",
        ),
        (r'(    \{ photograph = "t.*\n)', r"\1\1", r"\[\[tracking\]\] 2 is a copy of \[\[tracking\]\] 1; remove it"),
        ("stage_mm = .2.0, 0.0", "stage_mm = [9e3, 0.0", r"travel of \[\[\w+\]\].*another unit"),
        ("version = 1", "version = 2", "this program reads version 1"),
    ],
)
def test_each_fault_is_named(session: PhotoSession, pattern: str, text: str, complaint: str) -> None:
    folder = edited(session, pattern, text)
    with pytest.raises(BadInputError, match=complaint) as caught:
        load_photo_session(folder)
    assert "\n" not in str(caught.value)
    assert str(session.folder) in str(caught.value)


def test_a_folder_without_a_session_says_so(tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match=r"has no session\.toml"):
        load_photo_session(tmp_path)
    (tmp_path / "bench.toml").write_text("")
    with pytest.raises(BadInputError, match=r"is a bench session, .* run `wlr-render calibrate "):
        load_photo_session(tmp_path)


def test_an_unknown_key_is_refused(session: PhotoSession) -> None:
    with (session.folder / FILE).open("a") as file:
        file.write("\n[camera]\nwidth = 3\n")
    with pytest.raises(BadInputError, match="unknown key 'camera'"):
        load_photo_session(session.folder)


def test_photographs_outside_the_folder_keep_their_path(session: PhotoSession, tmp_path: Path) -> None:
    elsewhere = tmp_path.parent / "x.png"
    assert replace(session, bare=()).name_of(elsewhere) == str(elsewhere)
    assert session.bare[0].name == session.name_of(session.bare[0].path) == "b0.png"
