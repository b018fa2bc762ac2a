from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from synthetic_station import (
    DEVICE_FROM_CAMERA,
    DEVICE_FROM_TRACKING,
    EYEBALL,
    REFERENCE,
    STAGE_AXES,
    TRACKING,
    Faults,
    bench,
    device_from_camera,
    device_from_target,
    lens_views,
    stage_grid,
    station_of,
    visited,
)

from wlr_render.calibration.board_poses import poses_of
from wlr_render.calibration.camera_calibration import calibrate_camera
from wlr_render.calibration.check import refuse_contradictions
from wlr_render.calibration.poses import motion_between
from wlr_render.calibration.station import StationPhotos, find_station, repeated_views
from wlr_render.captures.photo_session import BoardPhotograph
from wlr_render.errors import BadInputError

CORNER = stage_grid()[0] + [-0.002, 0.001, 0.0]


@pytest.fixture(scope="module")
def many():
    """Forty clean runs of the procedure."""
    return [station_of(bench(seed, steps=3)) for seed in range(40)]


def in_sigmas(found, truth):
    """Squared error of poses with covariance, per number."""
    error = motion_between(truth, found.b_from_a)
    return error @ np.linalg.solve(found.covariance, error) / 6


def test_the_camera_is_where_it_says_to_be_within_its_sigmas(many):
    for reading in (REFERENCE, CORNER):
        scaled = [in_sigmas(station.pose_at(reading), device_from_camera(reading)) for station in many]
        assert 0.7 < np.sqrt(np.mean(scaled)) < 1.4


def test_each_number_of_the_cameras_pose_scatters_as_it_says(many):
    poses = [station.pose_at(CORNER) for station in many]
    error = np.array([motion_between(device_from_camera(CORNER), pose.b_from_a) for pose in poses])
    sigma = np.sqrt([np.diag(pose.covariance) for pose in poses])
    rms = np.sqrt(np.mean((error / sigma) ** 2, axis=0))
    assert np.all((rms > 0.7) & (rms < 1.4))


@pytest.mark.parametrize("urad", [30, 100, 200])
@pytest.mark.parametrize(("kind", "ratio"), [("smooth", (0.8, 1.4)), ("random", (0.8, 1.2))])
def test_a_stage_that_rolls_pitches_and_yaws_is_accepted_and_widens_the_sigmas(kind, ratio, urad):
    """Smooth rotation repeats at every visit and follows the reading, which two independent components do not say."""
    faults = Faults(**{f"{kind}_rotation_rad": 1e-6 * urad})
    rng = np.random.default_rng(urad)
    scaled, rotation_urad = [], []
    for seed in range(8):
        station = station_of(bench(seed, faults))
        refuse_contradictions(station.checks)
        assert station.stage.rejected == {}
        rotation_urad.append(1e6 * station.stage.jitter.rotation_rad)
        for reading in REFERENCE + rng.uniform(-0.008, 0.008, size=(6, 3)) * [1, 1, 0]:
            scaled.append(in_sigmas(station.pose_at(reading), visited(reading, faults, rng)))
    assert np.median(rotation_urad) == pytest.approx(urad, rel=0.5)
    assert ratio[0] < np.sqrt(np.mean(scaled)) < ratio[1]


def test_targets_are_where_they_say_to_be_within_their_sigmas(many):
    scaled = [
        in_sigmas(pose, device_from_target(k)) for station in many for k, pose in station.device_from_target.items()
    ]
    assert 0.7 < np.sqrt(np.mean(scaled)) < 1.4


def test_clean_runs_raise_no_alarm(many):
    alarms = [[check.sentence for check in station.checks if not check.ok] for station in many]
    assert sum(map(bool, alarms)) <= 2, alarms
    assert all(len(station.checks) == 10 for station in many)


def test_camera_and_lens_from_the_same_photographs_are_as_sure_as_they_say():
    scaled = []
    for seed in range(20):
        made = bench(seed, steps=3)
        views = [*lens_views(np.random.default_rng(seed + 1000), every=6), *made.bare]
        station = station_of(made, calibrate_camera(views, EYEBALL.size_px).poses)
        scaled.append(in_sigmas(station.pose_at(CORNER), device_from_camera(CORNER)))
    assert 0.7 < np.sqrt(np.mean(scaled)) < 1.4


def test_stage_axes_are_the_true_ones_in_the_device(many):
    expected = DEVICE_FROM_CAMERA[:3, :3] @ STAGE_AXES[:, :2]
    mean = np.mean([station.stage_axes_in_device for station in many], axis=0)
    np.testing.assert_allclose(mean, expected, atol=1e-4)


@pytest.mark.parametrize("shape", [(), (1,), (3, 1, 2)])
def test_readings_of_any_shape(many, shape):
    readings = REFERENCE + np.random.default_rng(1).uniform(-0.008, 0.008, size=(*shape, 3)) * [1, 1, 0]
    found = many[0].device_from_camera(readings)
    assert found.shape == (*shape, 4, 4)
    np.testing.assert_allclose(found, device_from_camera(readings), atol=3e-4)
    if shape == ():
        np.testing.assert_allclose(many[0].pose_at(readings).b_from_a, found)


def test_two_target_poses_know_the_camera_better_than_one():
    both = station_of(bench(1)).pose_at(CORNER)
    one = station_of(bench(1, bare_targets=(0,))).pose_at(CORNER)
    assert np.all(both.sigma_mm < one.sigma_mm)


def test_what_cannot_be_checked_is_said():
    made = bench(1, bare_targets=(0,))
    only_before = [photo for photo in made.photos.tracking if photo.name.endswith("a.png")]
    station = station_of(replace(made, photos=StationPhotos(made.photos.bare, only_before)))
    assert len(station.unchecked) == 3
    assert "sweep at target pose 1" in station.unchecked[1]
    assert "second target pose" in station.unchecked[2]
    assert station_of(bench(1)).unchecked == ()


def test_a_photograph_without_a_pose_is_left_out_and_named():
    made = bench(1)
    blind = [
        replace(view, pixel=view.pixel[:3], point=view.point[:3], sigma_px=view.sigma_px[:3]) for view in made.bare
    ]
    station = station_of(replace(made, bare=[*made.bare[:4], blind[4], *made.bare[5:]]))
    said = [check for check in station.checks if not check.ok]
    assert [check.step for check in said] == ["bare/04.png"]
    assert "shows only 3 dots" in said[0].sentence


def test_steps_that_were_left_out_are_named():
    made = bench(1, bare_targets=(0,))
    far = [photo for photo in made.photos.tracking if photo.target_pose == 1]
    with pytest.raises(BadInputError, match=r"without the headset \(poses \[0\]\).*tracking camera \(poses \[1\]\)"):
        station_of(replace(made, photos=StationPhotos(made.photos.bare, far)))
    with pytest.raises(BadInputError, match="no photograph without the headset"):
        station_of(replace(made, photos=StationPhotos([], made.photos.tracking)))
    with pytest.raises(BadInputError, match="no photograph by the tracking camera"):
        find_station(
            StationPhotos(made.photos.bare, []),
            poses_of(EYEBALL, made.bare),
            poses_of(TRACKING, []),
            DEVICE_FROM_TRACKING,
        )


def test_a_fault_leaves_the_sound_photographs_their_precision():
    clean, faulty = station_of(bench(1)), station_of(bench(1, Faults(moved_photograph=7)))
    np.testing.assert_allclose(faulty.pose_at(CORNER).sigma_mm, clean.pose_at(CORNER).sigma_mm, rtol=0.3)
    assert in_sigmas(faulty.pose_at(CORNER), device_from_camera(CORNER)) < 4


def test_repeated_photographs_are_found_by_target_and_place():
    made = bench(1)
    views = {view.name: view for view in made.bare}
    photos = [
        BoardPhotograph(Path(), name, target, np.array([x, 0.0, 0.0]), place=str(x))
        for name, target, x in [
            ("bare/00.png", 0, 0.0),
            ("bare/01.png", 0, 0.001),
            ("bare/02.png", 1, 0.0),
            ("bare/03.png", 0, 0.0),
            ("unreadable.png", 0, 0.001),
            ("bare/05.png", 0, 0.0),
        ]
    ]
    (found,) = repeated_views(photos, views)
    assert (found.target, found.first.name, found.last.name) == (0, "bare/00.png", "bare/05.png")
