import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from wlr_render.errors import BadInputError
from wlr_render.geometry import directions
from wlr_render.tracking.eye_model import RotatingEye
from wlr_render.tracking.trajectory import EyeTrajectory, GazeTrack, HeadTrajectory, ViewpointTrack

LEADS = [(), (1,), (3, 1, 2)]


@pytest.fixture
def head() -> HeadTrajectory:
    rng = np.random.default_rng(1)
    time_s = np.cumsum(rng.uniform(0.01, 0.2, 20))
    return HeadTrajectory(time_s, rng.normal(size=(20, 3)), Rotation.random(20, rng=rng).as_quat())


@pytest.fixture
def gaze() -> GazeTrack:
    rng = np.random.default_rng(2)
    gaze_dir = directions.dir_of_tangents(rng.uniform(-0.5, 0.5, (10, 2)))
    return GazeTrack(np.linspace(1, 2, 10), gaze_dir, RotatingEye(np.array([0.03, 0.0, -0.02])))


def test_the_head_is_exact_at_its_samples(head: HeadTrajectory) -> None:
    pose = head.at(head.time_s)
    np.testing.assert_allclose(pose[:, :3, 3], head.position_in_world, atol=1e-15)
    expected = Rotation.from_quat(head.world_from_device_xyzw).as_matrix()
    np.testing.assert_allclose(pose[:, :3, :3], expected, atol=1e-14)


@pytest.mark.parametrize("lead", LEADS)
def test_the_head_agrees_with_scipy_between_its_samples(head: HeadTrajectory, lead: tuple[int, ...]) -> None:
    moment = np.random.default_rng(3).uniform(head.time_s[0], head.time_s[-1], lead)
    pose = head.at(moment)
    assert pose.shape == (*lead, 4, 4)
    rotation = Slerp(head.time_s, Rotation.from_quat(head.world_from_device_xyzw))(moment.ravel()).as_matrix()
    np.testing.assert_allclose(pose[..., :3, :3].reshape(-1, 3, 3), rotation, atol=1e-12)
    for axis in range(3):
        expected = np.interp(moment, head.time_s, head.position_in_world[:, axis])
        np.testing.assert_allclose(pose[..., axis, 3], expected, atol=1e-14)


@pytest.mark.parametrize("interval_s", [0.002, 0.011, 0.5])
def test_a_gap_is_where_two_samples_are_missing_whatever_the_rate(interval_s: float) -> None:
    sample = np.array([0.0, 1.0, 2.0, 3.0, 6.0, 7.0, 9.0, 10.0])
    track = ViewpointTrack(interval_s * sample, np.zeros((8, 3)))
    moment = np.array([0.5, 3.0, 3.1, 5.9, 6.0, 8.0])
    gaps = track.gaps_at(interval_s * moment)
    np.testing.assert_allclose(gaps.start_s, interval_s * np.array([0.5, 3.0, 3.0, 3.0, 6.0, 8.0]), atol=1e-12)
    np.testing.assert_allclose(gaps.length_s, interval_s * np.array([0, 0, 3, 3, 0, 0]), atol=1e-12)


def test_a_sample_that_the_recording_calls_invalid_makes_a_gap() -> None:
    track = ViewpointTrack(np.array([0.0, 1.0, 3.0, 4.0]), np.zeros((4, 3)), invalid_s=np.array([-1.0, 2.0, 5.0]))
    np.testing.assert_array_equal(track.gaps_at([0.5, 1.0, 1.5, 2.5, 3.5]).length_s, [0, 0, 2, 2, 0])


@pytest.mark.parametrize("moment", [0.9, 2.1, np.nan])
def test_a_moment_outside_is_refused_with_the_range(head: HeadTrajectory, gaze: GazeTrack, moment: float) -> None:
    with pytest.raises(BadInputError, match=r"lies outside its range 1\.000000 to 2\.000000 s"):
        gaze.viewpoint_at([1.5, moment])
    with pytest.raises(BadInputError, match="head trajectory: time"):
        head.at(head.time_s[-1] + 1e-6)


def test_times_must_ascend_and_be_two_at_least() -> None:
    position, xyzw = np.zeros((3, 3)), np.tile([0, 0, 0, 1.0], (3, 1))
    with pytest.raises(BadInputError, match=r"sample 2 at 0\.5"):
        HeadTrajectory(np.array([0.0, 1.0, 0.5]), position, xyzw)
    with pytest.raises(BadInputError, match="at least two"):
        ViewpointTrack(np.array([0.0]), np.zeros((1, 3)))


@pytest.mark.parametrize("lead", LEADS)
def test_a_gaze_turns_at_a_constant_rate_in_one_plane(lead: tuple[int, ...]) -> None:
    gaze_dir = directions.dir_of_tangents(np.array([[-0.8, 0.1], [0.9, 0.4]]))
    track = GazeTrack(np.array([0.0, 1.0]), gaze_dir, RotatingEye(np.zeros(3)))
    fraction = np.random.default_rng(4).uniform(0, 1, lead)
    here = track.gaze_at(fraction)
    whole = directions.angle_between(*gaze_dir)
    np.testing.assert_allclose(directions.angle_between(here, gaze_dir[0]), fraction * whole, atol=1e-12)
    np.testing.assert_allclose(here @ np.cross(*gaze_dir), 0, atol=1e-15)


def test_a_gaze_is_exact_at_its_samples_and_where_it_rests(gaze: GazeTrack) -> None:
    np.testing.assert_allclose(gaze.gaze_at(gaze.time_s), gaze.gaze_dir, atol=1e-15)
    still = GazeTrack(gaze.time_s, np.tile(gaze.gaze_dir[0], (10, 1)), gaze.eye_model)
    np.testing.assert_allclose(still.gaze_at(1.234), gaze.gaze_dir[0], atol=1e-15)


def test_viewpoints_are_linear_and_eyes_are_told_apart(gaze: GazeTrack) -> None:
    right = ViewpointTrack(np.array([0.0, 1.0]), np.array([[0.03, 0, 0], [0.04, 0, 0.01]]))
    eyes = EyeTrajectory({"right": right, "left": gaze})
    np.testing.assert_allclose(eyes.viewpoint_at("right", 0.25), [0.0325, 0, 0.0025], atol=1e-17)
    np.testing.assert_array_equal(eyes.viewpoint_at("left", 1.5), gaze.viewpoint_at(1.5))
    with pytest.raises(BadInputError, match="no eye 'right' in it, only left"):
        EyeTrajectory({"left": gaze}).viewpoint_at("right", 0.5)
