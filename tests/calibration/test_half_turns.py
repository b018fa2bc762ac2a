"""Boards that look the same turned by 180 degrees are numbered alike in all photographs of a target, or refused."""

from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from calibration.bench.imperfect_bench import turned

from wlr_render.calibration.calibrate_session import with_half_turns
from wlr_render.captures.boards.board import BoardObservation
from wlr_render.captures.boards.chessboard import Chessboard
from wlr_render.captures.photo_session import BoardPhotograph, GivenPose, PhotoSession
from wlr_render.captures.session_reading import Reading
from wlr_render.errors import BadInputError
from wlr_render.geometry import transforms
from wlr_render.lenses.lens_camera import LensCamera

BOARD = Chessboard(6, 4, 0.03, 0.0)
LENS = LensCamera((640, 480), np.full(2, 600.0), np.array([320.0, 240.0]))
UPSIDE_DOWN = transforms.rigid(turned(0, 0, 180) @ transforms.OPENXR_FROM_OPENCV, np.zeros(3))


def seen(roll_deg: int, numbered_from_the_other_end: bool) -> BoardObservation:
    """A tilted board in a picture."""
    index = BOARD.indices()
    pose = transforms.rigid(turned(0, 0, roll_deg) @ turned(20, -15, 0), np.array([0.02, 0.01, 0.4]))
    pixel = LENS.pixel_of_point(transforms.apply(pose, BOARD.point_of(index)))
    observation = BoardObservation(index, pixel, np.full(len(index), 0.02), ambiguous_half_turn=True)
    return observation.half_turned(BOARD) if numbered_from_the_other_end else observation


def photograph(name: str) -> BoardPhotograph:
    return BoardPhotograph(Path("session"), name, 0)


def resolved(
    boards: dict[str, BoardObservation],
    tracking: Mapping[str, BoardObservation] | tuple[()] = (),
    **session: Mapping[int, GivenPose] | int,
) -> list[int]:
    """Index of the first feature in each photograph, 0 where it is that of the true board."""
    names = [*boards, *tracking]
    usual: dict[str, object] = {
        "targets": {},
        "gauge_target": None,
        "device_from_tracking": UPSIDE_DOWN,
        "board_of": lambda _: BOARD,
    }
    lists = {
        "bare": [photograph(name) for name in boards],
        "beside": [],
        "see_through": [],
        "tracking": [photograph(name) for name in tracking],
    }
    reading = Reading({photograph(name).path: (boards | dict(tracking))[name] for name in names})
    found = with_half_turns(cast(PhotoSession, SimpleNamespace(**lists, **(usual | session))), reading)
    return [int(found.boards[photograph(name).path].index[0].sum()) for name in names]


def test_all_photographs_of_a_target_are_numbered_from_the_end_of_the_first() -> None:
    boards = {"a.png": seen(3, False), "b.png": seen(-20, True), "c.png": seen(30, False)}
    assert resolved(boards) == [0, 0, 0]
    boards["a.png"] = seen(3, True)
    assert len(set(resolved(boards))) == 1


def test_a_tracking_camera_that_is_mounted_upside_down_sees_the_board_so() -> None:
    assert resolved({"a.png": seen(0, False)}, {"t.png": seen(180, False)}) == [0, 0]
    assert resolved({"a.png": seen(0, False)}, {"t.png": seen(180, True)}) == [0, 0]


def test_a_given_target_pose_says_which_way_round_the_board_hangs() -> None:
    upright = GivenPose(transforms.rigid(transforms.OPENXR_FROM_OPENCV, np.zeros(3)), (0.0, 0.0))
    assert resolved({"a.png": seen(5, True)}, targets={0: upright}) == [0]
    assert resolved({"a.png": seen(5, True)}, gauge_target=0) == [0]
    hanging = GivenPose(UPSIDE_DOWN, (0.0, 0.0))
    assert resolved({"a.png": seen(5, False)}, targets={0: hanging}) == [8]


def test_a_board_on_its_side_is_refused() -> None:
    with pytest.raises(
        BadInputError, match=r"b.png: the board looks the same turned .* keep cameras and board upright"
    ):
        resolved({"a.png": seen(0, False), "b.png": seen(85, False)})


def test_boards_that_can_be_told_apart_are_left_as_they_are() -> None:
    boards = {"a.png": seen(0, False), "b.png": seen(170, False)}
    plain = {name: BoardObservation(each.index, each.pixel, each.sigma_px) for name, each in boards.items()}
    assert resolved(plain) == [0, 0]
