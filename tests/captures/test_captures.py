import dataclasses

import numpy as np
import pytest

from wlr_render.captures.correspondences import (
    DisplayCaptures,
    EyeCaptures,
    SeeThroughCaptures,
    concatenate,
    select,
)
from wlr_render.errors import BadInputError
from wlr_render.mappings import EyeBox, Panel

EYE_BOX = EyeBox(np.array([0.03, 0.0, 0.02]), np.array([0.010, 0.008, 0.006]))
FORWARD = np.array([[0.0, 0.0, -1.0], [0.6, 0.0, -0.8], [0.0, 0.28, -0.96]])
PIXEL = np.array([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]])
WHERE = np.zeros((3, 3))
INDEX = np.array([0, 0, 1])


def display(**changes):
    values = {"viewpoint": WHERE, "view_dir": FORWARD, "pixel": PIXEL, "capture": INDEX, "sigma_arcmin": 1.0}
    return DisplayCaptures("toy", "right", EYE_BOX, Panel(10, 8), **(values | changes))


def see_through(**changes):
    values = {
        "viewpoint": WHERE,
        "view_dir": FORWARD,
        "point": FORWARD,
        "capture": INDEX,
        "target_pose": INDEX,
        "sigma_arcmin": np.array([1.0, 2.0, 3.0]),
    }
    return SeeThroughCaptures("toy", "right", EYE_BOX, **(values | changes))


def test_one_sigma_stands_for_all_rows():
    np.testing.assert_array_equal(display(sigma_arcmin=0.5).sigma_arcmin, [0.5, 0.5, 0.5])
    assert len(display()) == 3


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
        ({"sigma_arcmin": np.ones(2)}, r"'sigma_arcmin' must be one number or 3"),
        ({"viewpoint": np.empty((0, 3))}, "there are no rows"),
    ],
)
def test_bad_display_captures_are_refused(changes, sentence):
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
def test_bad_see_through_captures_are_refused(changes, sentence):
    with pytest.raises(BadInputError, match=sentence):
        see_through(**changes)


def test_eyes_are_left_or_right_and_do_not_mix():
    with pytest.raises(BadInputError, match="'eye' is 'middle'"):
        dataclasses.replace(display(), eye="middle")
    with pytest.raises(BadInputError, match=r"of toy \(right eye\), the see-through captures of toy \(left eye\)"):
        EyeCaptures(display(), dataclasses.replace(see_through(), eye="left"))


def test_selected_rows_join_to_the_whole():
    captures = see_through()
    parts = [select(captures, captures.capture == index) for index in (0, 1)]
    assert [len(part) for part in parts] == [2, 1]
    joined = concatenate(parts)
    for name in ("viewpoint", "view_dir", "point", "capture", "target_pose", "sigma_arcmin"):
        np.testing.assert_array_equal(getattr(joined, name), getattr(captures, name))
