"""session.toml: written and read back the same; each fault is one sentence that names the key."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from wlr_render.captures.boards.board_design import design_board
from wlr_render.captures.boards.board_file import save_board
from wlr_render.captures.decoded import DecodeOptions
from wlr_render.captures.patterns.catalogue import make_pattern
from wlr_render.captures.photo_session import BoardPhotograph, CodeSet, PhotoSession, SessionCamera, SessionPanel
from wlr_render.captures.photo_session_file import FILE, load_photo_session, save_photo_session
from wlr_render.captures.photograph_format import PhotographFormat
from wlr_render.captures.photographs import write_photograph
from wlr_render.errors import BadInputError
from wlr_render.geometry import transforms
from wlr_render.lenses.lens_camera import LensCamera
from wlr_render.mappings import EyeBox, Panel


@pytest.fixture
def session(tmp_path: Path) -> PhotoSession:
    board = design_board(8, 7, 0.02)
    save_board(board, tmp_path / "board.toml")
    for number in range(3):
        write_photograph(tmp_path / "lens" / f"{number}.png", np.zeros((4, 4), np.uint8))
    lens = LensCamera((640, 480), np.array([700.0, 701.0]), np.array([321.0, 239.5]), np.array([0.1, 0.0, 0.0, 0, 0]))
    made = PhotoSession(
        folder=tmp_path,
        device="a headset",
        eyes=("left",),
        eye_boxes={"left": EyeBox(np.array([0.001, -0.002, 0.003]), np.array([0.01, 0.008, 0.006]))},
        panels={"left": SessionPanel(make_pattern("gray-fringes", Panel(320, 200)))},
        decoding=DecodeOptions(full_scale=4095),
        board=board,
        eyeball_camera=SessionCamera(
            (640, 512), PhotographFormat(12), tuple(tmp_path / "lens" / f"{k}.png" for k in range(3))
        ),
        tracking_camera=SessionCamera((640, 480), PhotographFormat(8), calibrated=lens),
        device_from_tracking=transforms.rigid(
            transforms.rotation_about("x", 0.1) @ transforms.OPENXR_FROM_OPENCV, np.array([0.01, 0.04, -0.05])
        ),
        bare=(BoardPhotograph(tmp_path, "bare/0.png", 0, stage=np.array([0.001, 0.002, -0.003])),),
        tracking=(BoardPhotograph(tmp_path, "t.png", 0),),
        see_through=(BoardPhotograph(tmp_path, "s.png", 0, stage=np.array([0.004, 0.0, 0.0])),),
        display=(
            CodeSet(tmp_path / "d0", stage=np.zeros(3)),
            CodeSet(tmp_path / "d1", stage=np.array([0.004, 0.001, 0.0])),
        ),
    )
    save_photo_session(made, {"pattern": "gray-fringes"}, "board.toml")
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
        ("stage_mm = .4.0, -1.0", "stage_mm = [0.004, -0.001", r"travel of \[\[display\]\].*another unit"),
        (
            "translation_mm = .*",
            "translation_mm = [0.01, 0.04, 0.05]",
            "'translation_mm' .* 0.5 to 1000 mm long",
        ),
        ("stage_mm", "stage_um", "key 'stage_mm' is missing"),
        ("stage_mm = .*", "stage_mm = [1.0, 2.0]", "must be a list of 3 numbers"),
        ("bits = 12", "bits = 7", "'bits' must be a whole number from 8 to 16, not 7"),
        ('eye = "left"', 'eye = "middle"', "must be one of left, right"),
        ('pattern = "gray-fringes"', 'pattern = "grey"', "'pattern' is 'grey'; it must be one of gray, "),
        (
            '0.png"\ntarget_pose = 0',
            '0.png"\ntarget_pose = 3',
            r"\[\[bare\]\] number 1 is of target pose 3, which has no",
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
        ('"bare/0.png"', '"../0.png"', r"\[\[bare\]\] number 1: 'photograph': '../0.png' leads out of the folder"),
        ('photographs = "d0"', 'photographs = "/etc"', "'/etc' leads out of the folder"),
        ('board = "board.toml"', 'board = "../board.toml"', "'../board.toml' leads out of the folder"),
        ('intrinsics = "lens"', 'intrinsics = "../lens"', "leads out of the folder"),
        ('intrinsics = "lens"', 'lens_file = "../lens"', "leads out of the folder"),
        (
            "stage_mm = .4.0, -1.0",
            "stage_mm = [4e5, -1.0",
            "'stage_mm' has the value 400000; it must be .* at most 10000",
        ),
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
    assert session.bare[0].name == session.name_of(session.bare[0].path) == "bare/0.png"
