from dataclasses import replace

import numpy as np
import pytest
from synthetic_station import BOARD, EYEBALL, NOISE_PX, board_view, lens_views, tilted_poses, turned

from wlr_render.calibration.board_poses import BoardView, poses_of
from wlr_render.calibration.poses import motion_between
from wlr_render.captures.boards.board import BoardObservation
from wlr_render.geometry import transforms


def test_without_noise_the_poses_are_exact():
    truth = tilted_poses()
    views = [
        BoardView(f"{i}", point, EYEBALL.pixel_of_point(transforms.apply(pose, point)), np.ones(len(point)))
        for i, pose in enumerate(truth)
        for point in [BOARD.point_of(BOARD.indices()[200:260])]
    ]
    found = poses_of(EYEBALL, views)
    np.testing.assert_allclose(motion_between(truth, found.camera_from_board), 0.0, atol=1e-9)
    assert found.rejected == {}


def test_poses_scatter_as_they_say():
    truth = tilted_poses()
    scaled = []
    for seed in range(40):
        found = poses_of(EYEBALL, lens_views(np.random.default_rng(seed), every=7))
        error = motion_between(truth, found.camera_from_board).ravel()
        scaled.append(error @ np.linalg.solve(found.covariance, error) / len(error))
    assert 0.9 < np.sqrt(np.mean(scaled)) < 1.1


def test_noise_is_read_off_the_dots_not_believed():
    views = lens_views(np.random.default_rng(1))
    misjudged = [replace(view, sigma_px=view.sigma_px * 10) for view in views]
    right, wrong = poses_of(EYEBALL, views), poses_of(EYEBALL, misjudged)
    np.testing.assert_allclose(wrong.covariance, right.covariance, rtol=1e-4, atol=1e-18)
    np.testing.assert_allclose(right.rms_px, NOISE_PX, rtol=0.2)


def test_stray_dots_are_left_out():
    clean = lens_views(np.random.default_rng(2))
    pixel = clean[3].pixel.copy()
    pixel[[5, 40]] += [3.0, -2.0]
    spoilt = [*clean[:3], replace(clean[3], pixel=pixel), *clean[4:]]
    found = poses_of(EYEBALL, spoilt)
    sigma = np.sqrt(np.diag(found["lens/03.png"].covariance))
    error = motion_between(tilted_poses()[3], found["lens/03.png"].b_from_a)
    assert np.all(np.abs(error) < 5 * sigma)
    assert found.rms_px[3] < 1.3 * NOISE_PX


def test_photographs_that_are_no_good_are_set_aside_by_name():
    rng = np.random.default_rng(3)
    views = lens_views(rng)
    bent = BOARD.point_of(BOARD.indices()[::4])
    bent[:, 2] = 0.002 * (bent[:, 0] / 0.17) ** 2
    flat = BOARD.point_of(BOARD.indices()[::4])
    seen = board_view("bent.png", EYEBALL, tilted_poses()[0], rng, point=bent)
    assert len(seen) == len(flat)
    few = replace(views[0], name="few.png", point=flat[:5], pixel=views[0].pixel[:5], sigma_px=views[0].sigma_px[:5])
    found = poses_of(EYEBALL, [*views, replace(seen, point=flat), few])
    assert set(found.rejected) == {"bent.png", "few.png"}
    assert "flat board" in found.rejected["bent.png"]
    assert "only 5 dots" in found.rejected["few.png"]
    assert found.names == tuple(view.name for view in views)


def test_a_fragment_of_the_board_may_be_taken_two_ways_and_the_right_one_is_found():
    rng = np.random.default_rng(4)
    point = BOARD.point_of(np.stack(np.meshgrid(np.arange(5), np.arange(4)), axis=-1).reshape(-1, 2))
    pose = transforms.rigid(turned(18, -12, 70), [0.1, 0.1, 0.6])
    found = poses_of(EYEBALL, [board_view("part.png", EYEBALL, pose, rng, point=point)])
    error = motion_between(pose, found.camera_from_board[0])
    assert error @ np.linalg.solve(found.covariance, error) < 40


def test_an_observation_becomes_a_view_with_board_points():
    index = np.array([[0, 0], [23, 17]])
    view = BoardView.of_observation("a.png", BoardObservation(index, np.zeros((2, 2)), np.ones(2)), BOARD)
    np.testing.assert_allclose(view.point, [[-0.1725, -0.1275, 0], [0.1725, 0.1275, 0]])


def test_some_of_the_poses_keep_their_covariance():
    found = poses_of(EYEBALL, lens_views(np.random.default_rng(5)))
    some = found.only(["lens/04.png", "lens/01.png"])
    for name in some.names:
        np.testing.assert_array_equal(some[name].covariance, found[name].covariance)
        np.testing.assert_array_equal(some[name].b_from_a, found[name].b_from_a)
    with pytest.raises(ValueError, match="not in tuple"):
        found.only(["lens/99.png"])
