"""Motion during a sweep, by photographs of the target that were repeated at one stage reading."""

from dataclasses import replace

import numpy as np
import pytest
from present import present

from wlr_render.calibration.bench.bench_checks import Check
from wlr_render.calibration.bench.board_views import EYEBALL, BoardView
from wlr_render.calibration.bench.sweep_checks import NEGLIGIBLE_ARCMIN, RepeatedView, sweep_check
from wlr_render.geometry.directions import ARCMIN
from wlr_render.geometry.transforms import apply, rigid, rotation_about
from wlr_render.lenses.lens_camera import LensCamera
from wlr_render.numerics.arrays import FloatArray

LENS = LensCamera((1280, 1024), np.full(2, 1350.0), np.array([640.0, 512.0]))
INDEX = np.stack(np.meshgrid(np.arange(20), np.arange(15)), axis=-1).reshape(-1, 2)
POINT = np.concatenate([(INDEX - [9.5, 7.0]) * 0.02, np.zeros((300, 1))], axis=1)
EXPECTED = (0.2 * ARCMIN, np.arange(6)), (0.2 * ARCMIN * 0.5, np.arange(6)[::-1])
"""Turn and shift across a line of sight of half a metre that displace by .2', and their order in a motion."""
AHEAD = rigid(np.eye(3), np.array([0.0, 0.0, 0.5]))


def repeated(after: FloatArray, noise_px: float, count: int = 300) -> RepeatedView:
    """A target that stood at AHEAD before, and at `after` when it was photographed again."""
    rng = np.random.default_rng(0)

    def view(name: str, camera_from_board: FloatArray) -> BoardView:
        pixel = LENS.pixel_of_point(apply(camera_from_board, POINT))[:count]
        noisy = pixel + rng.normal(0.0, noise_px, pixel.shape)
        return BoardView(name, EYEBALL, INDEX[:count], POINT[:count], noisy, np.full(count, noise_px), 0, "place")

    return RepeatedView(0, np.eye(4), view("first", AHEAD), view("last", after))


def check(after: FloatArray, noise_px: float, count: int = 300) -> Check:
    """The check of one repeated view."""
    return present(sweep_check(0, None, [repeated(after, noise_px, count)], LENS))


def moved_right(arcmin: float) -> FloatArray:
    return rigid(np.eye(3), np.array([0.5 * arcmin * ARCMIN, 0.0, 0.5]))


@pytest.mark.parametrize("noise_px", [0.03, 0.1, 0.2])
def test_a_shift_of_the_whole_picture_is_found_far_below_the_noise_of_one_dot(noise_px: float) -> None:
    found = check(moved_right(0.64), noise_px)
    assert not found.ok
    assert found.value == pytest.approx(0.64, abs=4.0 * found.sigma + 0.02)
    assert "features are displaced by 0.6" in found.sentence


def test_a_turn_about_the_middle_of_the_picture_is_found() -> None:
    found = check(AHEAD @ rigid(rotation_about("z", 2.0 * ARCMIN), np.zeros(3)), 0.1)
    assert not found.ok
    assert found.value == pytest.approx(2.0 * np.sqrt(np.mean(np.sum(POINT**2, axis=1))) / 0.5, rel=0.1)


@pytest.mark.parametrize("noise_px", [0.03, 0.2, 1.0])
def test_noise_and_motions_that_can_be_neglected_are_none(noise_px: float) -> None:
    for after in (AHEAD, moved_right(0.6 * NEGLIGIBLE_ARCMIN)):
        found = check(after, noise_px)
        assert found.ok
        assert found.sentence == "nothing moved by more than 0.3'"


def test_a_certain_motion_is_named_beside_a_larger_one_that_is_noise() -> None:
    noise, motion = repeated(moved_right(1.0), 2.5), repeated(moved_right(0.64), 0.03)
    alone = sweep_check(0, None, [noise], LENS)
    assert alone is not None
    assert alone.ok
    assert alone.value > NEGLIGIBLE_ARCMIN
    assert alone.sentence == "no motion of more than 0.3' is certain"
    found = sweep_check(0, None, [noise, motion], LENS)
    assert alone.value > present(found).value == pytest.approx(0.64, abs=0.05)
    assert not present(found).ok


def test_what_a_stage_and_its_warm_up_are_expected_to_do_is_no_motion() -> None:
    sound = replace(repeated(moved_right(0.64), 0.03), device_from_target=AHEAD)
    turns, shifts = (np.diag(np.square([size] * 3 + [0.0] * 3)[order]) for size, order in EXPECTED)
    for motion in (turns, shifts):
        found = sweep_check(0, None, [replace(sound, motion=motion)], LENS)
        assert found is not None
        assert found.ok
        assert found.sigma == pytest.approx(0.2 * np.sqrt(2.0), rel=0.1)  # two axes across the line of sight
    assert not present(sweep_check(0, None, [replace(sound, motion=0.04 * turns)], LENS)).ok
    slipped = replace(repeated(moved_right(13.0), 0.03), device_from_target=AHEAD, motion=100.0 * turns)
    assert present(sweep_check(0, None, [slipped], LENS)).contradictory  # no stage of use is as bad as that


def test_photographs_without_a_common_dot_show_nothing() -> None:
    rng = np.random.default_rng(0)
    views = [
        BoardView(name, EYEBALL, index, POINT[:10], rng.uniform(100, 900, (10, 2)), np.full(10, 0.1))
        for name, index in (("first", INDEX[:10]), ("last", INDEX[10:20]))
    ]
    assert present(sweep_check(0, None, [RepeatedView(0, np.eye(4), views[0], views[1])], LENS)).ok
