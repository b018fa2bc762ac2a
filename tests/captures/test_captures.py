import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from present import present

from wlr_render.captures.correspondences import (
    Captures,
    DisplayCaptures,
    SeeThroughCaptures,
    concatenate,
    select,
    with_copies,
)
from wlr_render.captures.feature_captures import CaptureMotionPrior
from wlr_render.errors import BadInputError
from wlr_render.mappings import EyeBox, Panel
from wlr_render.numerics.arrays import IntArray

EYE_BOX = EyeBox(np.array([0.03, 0.0, 0.02]), np.array([0.010, 0.008, 0.006]))
FORWARD = np.array([[0.0, 0.0, -1.0], [0.6, 0.0, -0.8], [0.0, 0.28, -0.96]])
PIXEL = np.array([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]])
WHERE = np.zeros((3, 3))
INDEX = np.array([0, 0, 1])
EYE: dict[str, Any] = {"device": "toy", "eye": "right", "eye_box": EYE_BOX}


def display(**changes: Any) -> DisplayCaptures:
    values: dict[str, Any] = {
        "viewpoint": WHERE,
        "view_dir": FORWARD,
        "pixel": PIXEL,
        "capture": INDEX,
        "sigma_arcmin": 1.0,
    }
    return DisplayCaptures(**EYE, panel=Panel(10, 8), **(values | changes))


def see_through(**changes: Any) -> SeeThroughCaptures:
    values = {
        "viewpoint": WHERE,
        "view_dir": FORWARD,
        "point": FORWARD,
        "capture": INDEX,
        "target_pose": INDEX,
        "sigma_arcmin": np.array([1.0, 2.0, 3.0]),
    }
    return SeeThroughCaptures(**EYE, **(values | changes))


def test_one_value_stands_for_all_rows_and_what_was_not_recorded_is_marked() -> None:
    captures = display(sigma_arcmin=0.5, viewpoint=WHERE[0], time_s=3.0, stage=np.array([1.0, 2.0]))
    np.testing.assert_array_equal(captures.sigma_arcmin, [0.5, 0.5, 0.5])
    np.testing.assert_array_equal(captures.viewpoint, WHERE)
    np.testing.assert_array_equal(captures.time_s, [3.0, 3.0, 3.0])
    np.testing.assert_array_equal(captures.stage, [[1.0, 2.0]] * 3)
    assert captures.channel.tolist() == captures.target_pose.tolist() == [-1, -1, -1]
    assert np.isnan(captures.device_from_camera).all()
    assert (len(captures), display().stage.shape) == (3, (3, 0))


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"pixel": PIXEL[:2]}, r"'pixel' must have shape \(3, 2\), not \(2, 2\)"),
        ({"view_dir": 2 * FORWARD}, "'view_dir' must be unit vectors that look forward"),
        ({"view_dir": -FORWARD}, "'view_dir' must be unit vectors that look forward"),
        ({"viewpoint": WHERE * np.nan}, "'viewpoint' has numbers that are not finite"),
        ({"capture": np.array([0.0, 1.0, 2.0])}, "'capture' must be 3 whole numbers, not float64"),
        ({"sigma_arcmin": -1.0}, "'sigma_arcmin' must be positive everywhere"),
        ({"sigma_arcmin": np.array([0.0, 1.0, 1.0])}, "'sigma_arcmin' must be positive everywhere"),
        ({"sigma_arcmin": np.ones(2)}, r"'sigma_arcmin' must have shape \(3,\), not \(2,\)"),
        ({"sigma_arcmin": np.nan}, "'sigma_arcmin' has numbers that are not finite"),
        ({"view_dir": np.empty((0, 3))}, "the table is empty"),
        ({"time_s": np.zeros(2)}, r"'time_s' must have shape \(3,\), not \(2,\)"),
    ],
)
def test_bad_display_captures_are_refused(changes: Mapping[str, Any], sentence: str) -> None:
    with pytest.raises(BadInputError, match=sentence):
        display(**changes)


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"point": -FORWARD}, "not in front of their viewpoint"),
        ({"point": FORWARD[:, :2]}, r"'point' must have shape \(3, 3\)"),
        ({"target_pose": INDEX[:2]}, "'target_pose' must be 3 whole numbers"),
    ],
)
def test_bad_see_through_captures_are_refused(changes: Mapping[str, Any], sentence: str) -> None:
    with pytest.raises(BadInputError, match=sentence):
        see_through(**changes)


def test_eyes_are_left_or_right_and_do_not_mix() -> None:
    with pytest.raises(BadInputError, match="'eye' is 'middle'"):
        dataclasses.replace(display(), eye="middle")
    with pytest.raises(BadInputError, match=r"of toy \(right eye\), the see-through captures of toy \(left eye\)"):
        Captures(display(), dataclasses.replace(see_through(), eye="left"))


def test_selected_rows_join_to_the_whole() -> None:
    captures = see_through()
    parts = [select(captures, captures.capture == index) for index in (0, 1)]
    assert [len(part) for part in parts] == [2, 1]
    joined = concatenate(parts)
    for name in ("viewpoint", "view_dir", "point", "capture", "target_pose", "sigma_arcmin"):
        np.testing.assert_array_equal(getattr(joined, name), getattr(captures, name))


SIZES = np.arange(1.0, 13.0).reshape(2, 6)


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"size": SIZES[:, :3]}, r"'size' must have shape \(2, 6\), not \(2, 3\)"),
        ({"size": -SIZES}, "'size' has negative standard deviations"),
        ({"size": SIZES * np.nan}, "'size' has numbers that are not finite"),
        ({"capture": np.array([1, 1])}, "each only once"),
        ({"log_sigma": 0.0}, "'log_sigma' is 0.0; it must be a positive number"),
    ],
)
def test_a_bad_prior_of_motions_is_refused(changes: dict[str, Any], sentence: str) -> None:
    valid: dict[str, Any] = {"capture": INDEX[1:], "size": SIZES, "log_sigma": 0.1}
    with pytest.raises(BadInputError, match=f"^capture motions: .*{sentence}"):
        CaptureMotionPrior(**(valid | changes))


def test_every_capture_needs_a_motion() -> None:
    motion = CaptureMotionPrior(np.array([0, 2]), SIZES, 0.1)
    with pytest.raises(BadInputError, match="'motion' has no size for capture 1; give one for every capture"):
        display(motion=motion)
    with pytest.raises(BadInputError, match="'motion' has no size for capture 7"):
        see_through(motion=motion, visit=np.array([0, 2, 7]))


def test_visits_are_those_that_are_numbered_and_else_one_of_each_position_and_target_pose() -> None:
    assert len(display().visits[0]) == 2
    assert len(see_through(target_pose=np.array([0, 1, 0])).visits[0]) == 3
    names, visit = see_through(visit=np.array([5, 4, 4])).visits
    np.testing.assert_array_equal(names[visit], [5, 4, 4])
    assert len(names) == 3
    names, visit = display(visit=np.array([5, -1, 4])).visits
    np.testing.assert_array_equal(names[visit], INDEX)


def test_rows_keep_their_visits_and_motions() -> None:
    motion = CaptureMotionPrior(np.array([7, 3]), SIZES, 0.1)
    captures = see_through(visit=np.array([3, 3, 7]), motion=motion)
    chosen = concatenate([select(captures, np.array([2])), select(captures, np.array([0]))])
    assert chosen.motion is motion
    names, visit = chosen.visits
    np.testing.assert_array_equal(motion.of(names).size[visit], SIZES)


def test_parts_that_record_less_than_others_join_without_losing_anything() -> None:
    motion = CaptureMotionPrior(np.array([0, 1]), SIZES, 0.1)
    timed = see_through(
        time_s=np.array([1.0, 2.0, 3.0]),
        stage=np.ones((3, 2)),
        target_point=np.ones((3, 3)),
        motion=motion,
    )
    for parts, known in (((see_through(), timed), slice(3, 6)), ((timed, see_through()), slice(0, 3))):
        joined = concatenate(parts)
        np.testing.assert_array_equal(joined.time_s[known], [1.0, 2.0, 3.0])
        np.testing.assert_array_equal(joined.target_point[known], 1.0)
        assert np.isnan(joined.time_s).sum() == np.isnan(joined.target_point[:, 0]).sum() == 3
        assert joined.stage.shape == (6, 2)
        assert joined.motion is motion


@pytest.mark.parametrize("visit", [-1, np.array([4, 4, 9])])
def test_copies_are_visits_of_their_own_that_move_as_much(visit: IntArray | int) -> None:
    names = np.array([0, 1]) if np.ndim(visit) == 0 else np.array([4, 9])
    captures = see_through(visit=visit, motion=CaptureMotionPrior(names, SIZES, 0.1))
    copied = with_copies(captures, np.array([0, 1, 2, 2]), np.array([0, 0, 0, 1]))
    np.testing.assert_array_equal(copied.capture, [0, 0, 1, 2, 2, 2, 3])
    names, visit = copied.visits
    assert len(names) == 5
    size = present(copied.motion).of(names).size[visit]
    np.testing.assert_array_equal(size[3:5], SIZES[[0, 0]])
    np.testing.assert_array_equal(size[6], SIZES[1])


def test_copies_are_numbered_apart_from_captures_that_were_left_out() -> None:
    motion = CaptureMotionPrior(np.array([0, 1, 2]), np.concatenate([SIZES, 9.0 * SIZES[:1]]), 0.1)
    captures = see_through(motion=motion)
    copied = with_copies(captures, np.array([0]), np.array([0]))
    names, visit = copied.visits
    np.testing.assert_array_equal(present(copied.motion).of(names).size[visit[-1]], SIZES[0])
