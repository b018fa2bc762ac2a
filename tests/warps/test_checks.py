import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from flat_image import FlatImage
from present import narrowed

from wlr_render.errors import BadInputError
from wlr_render.geometry import transforms
from wlr_render.mappings import EYE_BOX_MARGIN, Eye, Panel
from wlr_render.warp.checks import (
    REACH,
    checked_background,
    checked_models,
    checked_pose,
    checked_size,
    checked_viewpoints,
    nearest_in_reach,
)


def left_of(eye: Eye) -> Eye:
    return dataclasses.replace(eye, eye="left")


def test_one_eye_needs_no_name_and_the_left_one_comes_first(flat_image_headset: Eye) -> None:
    assert checked_models(flat_image_headset) == {"right": (flat_image_headset,)}
    assert checked_models([flat_image_headset] * 3) == {"right": (flat_image_headset,) * 3}
    both: dict[str, Eye | Sequence[Eye]] = {"right": flat_image_headset, "left": [left_of(flat_image_headset)] * 3}
    assert [(eye, len(channels)) for eye, channels in checked_models(both).items()] == [("left", 3), ("right", 1)]


def test_models_that_do_not_belong_together_are_refused(flat_image_headset: Eye) -> None:
    wide = dataclasses.replace(narrowed(flat_image_headset.display, FlatImage), panel=Panel(7, 5))
    other_panel = dataclasses.replace(flat_image_headset, display=wide)
    elsewhere = dataclasses.replace(flat_image_headset.eye_box, centre=flat_image_headset.eye_box.centre + 0.001)
    moved = dataclasses.replace(flat_image_headset, eye_box=elsewhere)
    wrong: tuple[tuple[Any, str], ...] = (
        ({}, "'left', 'right' or both"),
        ({"middle": flat_image_headset}, "middle"),
        ({"right": [flat_image_headset] * 2}, "2 models"),
        ({"right": [flat_image_headset, other_panel, flat_image_headset]}, "panel"),
        ((flat_image_headset, moved, flat_image_headset), "eye box is not that"),
        (None, "NoneType is not a model"),
        ({"right": [flat_image_headset, "green", flat_image_headset]}, "str is not a model"),
    )
    for models, words in wrong:
        with pytest.raises(BadInputError, match=words):
            checked_models(models)


@pytest.mark.parametrize(
    "size", [(0, 5), (4.5, 3), (5,), 5, (5, 4, 3), (-2, 2), (np.nan, 2), (np.inf, 2), "360x400"], ids=str
)
def test_a_size_that_is_none_is_refused(size: Any) -> None:
    with pytest.raises(BadInputError, match="width, height"):
        checked_size(size)


@pytest.mark.parametrize("colour", [(0, 0, 256), (0, -1, 0), (0.5, 0.5, 0.5), (1, 2), "red", None], ids=str)
def test_a_background_that_is_no_colour_is_refused(colour: Any) -> None:
    codes: Any = np.array([1, 2, 255], np.uint8)
    assert checked_background(codes) == (1, 2, 255)
    with pytest.raises(BadInputError, match=r"sRGB codes|not made of numbers"):
        checked_background(colour)


def test_a_pose_is_a_rotation_and_a_translation() -> None:
    good = transforms.rigid(transforms.rotation_about("y", 0.3), np.array([5.0, -3.0, 2.0]))
    np.testing.assert_array_equal(checked_pose(good), good)
    lost, scaled, far = good.copy(), good.copy(), good.copy()
    lost[1, 3], scaled[:3, :3], far[2, 3] = np.nan, 2 * good[:3, :3], 1e9
    bad: Any
    for bad, words in (
        (good @ np.diag([1.0, 1.0, -1.0, 1.0]), "translation: it mirrors; convert .* on both sides, F @ pose @ F"),
        (scaled, "the pose is not a rotation and a translation: it scales by 2; divide"),
        (good.T, "transpose"),
        (lost, "the pose has nan in row 1, column 3; give finite"),
        (np.eye(3), "4 x 4"),
        ([[1, 0], [0]], "number"),
        (good.astype(str), "4 x 4"),
        (np.eye(4, dtype=bool), "4 x 4"),
        (np.eye(4).astype(complex), "4 x 4"),
        (None, "4 x 4"),
        (np.full((4, 4), 10**400), "4 x 4"),
        (far, "metres"),
    ):
        with pytest.raises(BadInputError, match=words):
            checked_pose(bad)


def test_a_rotation_that_was_rounded_is_made_one() -> None:
    exact = np.eye(4)
    exact[:3, :3] = transforms.rotation_about("y", 0.7) @ transforms.rotation_about("x", -0.3)
    rotation = checked_pose(exact + 2e-5 * np.pad(np.random.default_rng(1).uniform(-1, 1, (3, 3)), (0, 1)))[:3, :3]
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(rotation, exact[:3, :3], atol=5e-5)


def test_viewpoints_may_lie_a_little_outside_the_eye_box_and_no_more(flat_image_headset: Eye) -> None:
    models, box = checked_models(flat_image_headset), flat_image_headset.eye_box
    edge = box.centre + [0, (0.5 + REACH) * box.size[1] + EYE_BOX_MARGIN, 0]
    np.testing.assert_array_equal(checked_viewpoints(edge, models)["right"], edge)
    with pytest.raises(BadInputError, match=r"right eye lies .* mm from the eye box's centre in y"):
        checked_viewpoints(edge + [0, 1e-6, 0], models)
    for far, asks in ((np.array([0.0, 0.0, 0.5]), False), (np.array([0.0, 0.0, 10.0]), True)):
        with pytest.raises(BadInputError, match="within_reach") as told:
            checked_viewpoints(far, models)
        assert ("is it in metres?" in str(told.value)) == asks
    brought_back = nearest_in_reach(edge + [0, 0.05, 0], box)
    np.testing.assert_allclose(brought_back, edge, atol=1e-15)
    checked_viewpoints(brought_back, models)
    with pytest.raises(BadInputError, match="finite"):
        nearest_in_reach(edge * np.nan, box)


def test_viewpoints_are_given_by_eye(flat_image_headset: Eye) -> None:
    models = checked_models({"right": flat_image_headset, "left": left_of(flat_image_headset)})
    centre = flat_image_headset.eye_box.centre
    assert [*checked_viewpoints({"right": centre}, models)] == ["right"]
    wrong: tuple[tuple[Any, str], ...] = (
        (centre, "two eyes"),
        ({}, "no viewpoint of the left eye"),
        ({"left": centre, "right": [0, 0, np.nan]}, "finite"),
        ({"left": centre, "right": "here"}, "number"),
    )
    for viewpoint, words in wrong:
        with pytest.raises(BadInputError, match=words):
            checked_viewpoints(viewpoint, models)
