import numpy as np
from present import narrowed

from wlr_render.geometry import directions
from wlr_render.numerics.arrays import FloatArray
from wlr_render.tracking import synthetic
from wlr_render.tracking.minimum_jerk import minimum_jerk
from wlr_render.tracking.trajectory import GazeTrack

VIEWPOINTS = {"left": np.array([-0.032, 0, -0.03]), "right": np.array([0.032, 0, -0.03])}


def angular_speed_deg_s(rotation: FloatArray, rate_hz: float) -> FloatArray:
    step = np.swapaxes(rotation[:-1], 1, 2) @ rotation[1:]
    cosine = 0.5 * (np.trace(step, axis1=1, axis2=2) - 1)
    return np.asarray(np.rad2deg(np.arccos(np.clip(cosine, -1, 1))) * rate_hz)


def test_the_same_seed_gives_the_same_wearer_and_another_seed_another() -> None:
    first, again, other = (synthetic.head_motion(seed, 1.0) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first.at(0.5), again.at(0.5))
    assert np.abs(first.at(0.5) - other.at(0.5)).max() > 1e-3
    gazes = [synthetic.eye_motion(VIEWPOINTS, seed, 1.0).viewpoint_at("left", 0.5) for seed in (1, 1, 2)]
    np.testing.assert_array_equal(gazes[0], gazes[1])
    assert np.abs(gazes[0] - gazes[2]).max() > 1e-5


def test_the_head_stays_near_the_origin_and_turns_slowly() -> None:
    for seed in range(5):
        pose = synthetic.head_motion(seed, 20.0, rate_hz=90.0).at(np.arange(0, 1800) / 90.0)
        assert np.abs(pose[:, :3, 3]).max() <= 0.05
        speed = angular_speed_deg_s(pose[:, :3, :3], 90.0)
        assert 1.0 < speed.max() < 40.0
        assert pose[:, 2, 2].min() > np.cos(np.deg2rad(14))


def test_the_eyes_fixate_and_leap_and_their_gazes_meet() -> None:
    eyes = synthetic.eye_motion(VIEWPOINTS, 7, 10.0, rate_hz=500.0)
    left, right = (narrowed(eyes.tracks[eye], GazeTrack) for eye in ("left", "right"))
    speed = np.rad2deg(directions.angle_between(right.gaze_dir[:-1], right.gaze_dir[1:])) * 500.0
    assert 0.75 < np.mean(speed < 1.0) < 0.97
    assert 150 < speed.max() < 700
    normal = np.cross(left.gaze_dir, right.gaze_dir)
    between = right.eye_model.rotation_centre_in_device - left.eye_model.rotation_centre_in_device
    np.testing.assert_allclose(normal @ between, 0, atol=1e-16)
    converging = directions.tangents_of_dir(left.gaze_dir) - directions.tangents_of_dir(right.gaze_dir)
    assert converging[:, 0].min() > 0.064 / 3.1


def test_it_goes_all_the_way_without_turning_back_and_is_the_same_backwards() -> None:
    x = np.linspace(0, 1, 101)
    way = minimum_jerk(x)
    assert (way[0], way[-1]) == (0.0, 1.0)
    assert np.all(np.diff(way) > 0)
    np.testing.assert_allclose(way + way[::-1], 1.0, atol=1e-15)


def test_at_both_ends_it_is_at_rest_and_without_acceleration() -> None:
    step = 1e-4
    for end in (0.0, 1.0):
        before, at, after = minimum_jerk(end - step), minimum_jerk(end), minimum_jerk(end + step)
        assert abs(after - before) / (2 * step) < 1e-6
        assert abs(after - 2 * at + before) / step**2 < 1e-6
