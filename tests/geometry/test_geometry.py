from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from wlr_render.errors import BadInputError
from wlr_render.geometry import directions, pinhole, planes, rays, transforms
from wlr_render.geometry.pose_prediction import predicted_point, predicted_pose
from wlr_render.numerics.arrays import FloatArray

LEADS = [(), (1,), (3, 1, 2)]


@pytest.mark.parametrize("lead", LEADS)
def test_tangents_and_directions_round_trip(lead: tuple[int, ...]) -> None:
    rng = np.random.default_rng(1)
    tangents = rng.uniform(-1.5, 1.5, (*lead, 2))
    view_dir = directions.dir_of_tangents(tangents)
    np.testing.assert_allclose(np.linalg.norm(view_dir, axis=-1), 1, atol=1e-15)
    np.testing.assert_allclose(directions.tangents_of_dir(view_dir), tangents, atol=1e-14)


def test_a_direction_that_looks_back_has_no_tangents() -> None:
    assert np.isnan(directions.tangents_of_dir(np.array([0.0, 0.0, 1.0]))).all()


def test_small_angles_are_exact() -> None:
    angle = 1e-9
    first, second = np.array([0, 0, -1.0]), np.array([np.sin(angle), 0, -np.cos(angle)])
    assert directions.angle_between(first, second) == pytest.approx(angle, rel=1e-9)


def test_rigid_inverse_and_named_composition() -> None:
    rng = np.random.default_rng(2)
    b_from_a = transforms.rigid(Rotation.random(rng=rng).as_matrix(), rng.normal(size=3))
    point_in_a = rng.normal(size=(4, 5, 3))
    point_in_b = transforms.apply(b_from_a, point_in_a)
    np.testing.assert_allclose(transforms.apply(transforms.inverse(b_from_a), point_in_b), point_in_a, atol=1e-14)


def test_quaternions_and_rotation_vectors_turn_by_the_right_hand_rule() -> None:
    half = 0.5 * 0.3
    quarter_about_z = transforms.rotation_about("z", np.pi / 2)
    xyzw = np.array([[[np.sin(half), 0, 0, np.cos(half)]], [[0, 0, np.sqrt(0.5), np.sqrt(0.5)]]])
    vector = np.array([[[0.3, 0, 0]], [[0, 0, np.pi / 2]]])
    expected = np.stack([transforms.rotation_about("x", 0.3), quarter_about_z])[:, None]
    np.testing.assert_allclose(transforms.rotation_of_quaternion(xyzw), expected, atol=1e-15)
    np.testing.assert_allclose(transforms.rotations_of_vectors(vector), expected, atol=1e-15)
    np.testing.assert_array_equal(transforms.rotations_of_vectors(np.zeros(3)), np.eye(3))


def test_rotation_about_is_right_handed() -> None:
    np.testing.assert_allclose(transforms.rotation_about("z", np.pi / 2) @ [1, 0, 0], [0, 1, 0], atol=1e-15)
    np.testing.assert_allclose(transforms.rotation_about("x", np.pi / 2) @ [0, 1, 0], [0, 0, 1], atol=1e-15)


@pytest.mark.parametrize("slope", [(0.0, 0.0), (0.3, -0.2)])
@pytest.mark.parametrize("lead", LEADS)
def test_carrying_to_the_base_plane_stays_on_the_ray(lead: tuple[int, ...], slope: tuple[float, float]) -> None:
    rng = np.random.default_rng(4)
    plane = planes.BasePlane(-0.03, slope)
    point, tangents = rng.normal(size=(*lead, 3)), rng.uniform(-1, 1, (*lead, 2))
    carried = plane.lift(plane.carry(point, tangents))
    ray = rays.pack(point, directions.dir_of_tangents(tangents))
    np.testing.assert_allclose(rays.distance_to_point(ray, carried), 0, atol=1e-14)
    np.testing.assert_allclose(carried[..., 2], plane.z + carried[..., :2] @ slope, atol=1e-14)
    np.testing.assert_allclose(rays.at_z(ray, carried[..., 2])[..., :3], carried, atol=1e-12)
    np.testing.assert_allclose(plane.height_of(carried), 0, atol=1e-14)
    np.testing.assert_allclose(plane.carry(carried, tangents), carried[..., :2], atol=1e-14)


def test_derivatives_of_carrying_are_those_of_differences() -> None:
    rng = np.random.default_rng(5)
    plane = planes.BasePlane(-0.03, (0.3, -0.2))
    point, tangents, step = rng.normal(size=(6, 3)), rng.uniform(-1, 1, (6, 2)), 1e-6
    depth = plane.depth_along(point, tangents)
    for axis, away in enumerate(step * np.eye(2)):
        carried = plane.carry(point, tangents + away) - plane.carry(point, tangents - away)
        deeper = plane.depth_along(point, tangents + away) - plane.depth_along(point, tangents - away)
        expected = plane.carry_by_tangents(depth, tangents)[..., axis]
        np.testing.assert_allclose(carried / (2 * step), expected, rtol=1e-6, atol=1e-8)
        expected = plane.depth_by_tangents(depth, tangents)[..., axis]
        np.testing.assert_allclose(deeper / (2 * step), expected, rtol=1e-6, atol=1e-8)


def test_pinhole_covers_and_round_trips_with_v_down() -> None:
    tangents = np.array([[-0.4, -1.2], [0.5, 0.2], [np.nan, 0.0]])
    camera = pinhole.Pinhole.covering(tangents, 1000.0)
    pixel = camera.pixel_of_tangents(tangents[:2])
    assert (pixel >= 0).all()
    assert (pixel <= [camera.width_px, camera.height_px]).all()
    assert pixel[0, 1] > pixel[1, 1]  # lower in the world is further down the image
    np.testing.assert_allclose(camera.tangents_of_pixel(pixel), tangents[:2], atol=1e-14)
    np.testing.assert_allclose(camera.focal_px, 1000.0)
    np.testing.assert_allclose(camera.pixel_of_tangents(camera.pixel_centre_tangents())[3, 7], [7.5, 3.5], atol=1e-10)


def test_between_two_poses_the_turn_and_the_way_are_even() -> None:
    first = transforms.rigid(transforms.rotation_about("y", 0.3), np.array([1.0, 2.0, 3.0]))
    turn = transforms.rotations_of_vectors(np.array([0.02, -0.5, 0.9]))
    last = transforms.rigid(first[:3, :3] @ turn, np.array([1.5, 1.0, 3.0]))
    poses = transforms.between(first, last, np.linspace(0, 1, 5))
    np.testing.assert_allclose(poses[[0, -1]], [first, last], atol=1e-12)
    steps = transforms.inverse(poses[:-1]) @ poses[1:]
    np.testing.assert_allclose(steps[:, :3, :3], np.broadcast_to(steps[0, :3, :3], (4, 3, 3)), atol=1e-12)
    np.testing.assert_allclose(np.diff(poses[:, :3, 3], axis=0), np.tile([0.125, -0.25, 0.0], (4, 1)), atol=1e-12)


def turned(angle: float, x: float = 0.0) -> FloatArray:
    return transforms.rigid(transforms.rotation_about("y", angle), np.array([x, 1.5, -0.2]))


def test_a_head_at_constant_speed_is_predicted_exactly() -> None:
    start = transforms.rigid(transforms.rotation_about("x", 0.4), np.array([0.1, 0.2, 0.3]))
    poses = [start @ turned(0.0), start @ turned(0.02, 0.01), start @ turned(0.05, 0.025)]
    there = predicted_pose(poses[0], poses[1], 0.010, 0.015)
    np.testing.assert_allclose(there[:3, :3], poses[2][:3, :3], atol=1e-12)
    np.testing.assert_allclose(there[:3, 3], poses[2][:3, 3], atol=1e-12)
    np.testing.assert_allclose(predicted_pose(poses[0], poses[1], 0.010, 0.0), poses[1], atol=1e-12)


def test_a_pupil_moves_on_along_its_line() -> None:
    np.testing.assert_allclose(
        predicted_point(np.array([0.0, 1.0, 2.0]), np.array([0.1, 1.0, 1.8]), 0.02, 0.05), [0.35, 1.0, 1.3]
    )


@pytest.mark.parametrize(("between_s", "ahead_s"), [(0.01, 0.101), (0.01, -0.001), (0.0, 0.01), (0.2, 0.01)])
def test_far_predictions_are_refused(between_s: float, ahead_s: float) -> None:
    predictions: list[Callable[[], FloatArray]] = [
        lambda: predicted_pose(turned(0.0), turned(0.1), between_s, ahead_s),
        lambda: predicted_point(np.zeros(3), np.ones(3), between_s, ahead_s),
    ]
    for predict in predictions:
        with pytest.raises(BadInputError, match="give 0 to 100 ms, from poses at most 100 ms apart"):
            predict()
