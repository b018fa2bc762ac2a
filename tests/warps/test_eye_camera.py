import numpy as np
import pytest
from gl_scenes import OFF_CENTRE

from wlr_render.errors import BadInputError
from wlr_render.geometry import transforms
from wlr_render.geometry.pinhole import Pinhole
from wlr_render.numerics.arrays import FloatArray
from wlr_render.warp.eye_camera import EyeCamera
from wlr_render.warp.stored_picture import DepthKind, StoredDepth
from wlr_render.warp.view import View, image_from_ray_map

CAMERA = Pinhole(640, 400, np.array([-0.5, -0.3]), np.array([0.7, 0.45]))
HEAD = transforms.rigid(transforms.rotation_about("y", 0.4), np.array([1.0, 1.6, -2.0]))
PLACE = np.array([-0.03, 0.0, 0.01])  # in the device
EYE = EyeCamera("left", View(CAMERA, PLACE, HEAD, transforms.rotation_about("x", 0.1)), PLACE)
POINTS = np.random.default_rng(0).uniform([-0.5, -0.4, -6], [0.7, 0.4, -0.4], (50, 3))  # camera frame


def clip(projection: FloatArray) -> FloatArray:
    homogeneous = np.concatenate([POINTS, np.ones((len(POINTS), 1))], axis=1) @ projection.T
    return homogeneous[:, :3] / homogeneous[:, 3:]


def test_the_projection_puts_points_on_the_pinholes_pixels() -> None:
    pixel = (clip(EYE.projection(0.1, 50.0))[:, :2] * [1, -1] + 1) / 2 * EYE.size_px
    depth = -POINTS[:, 2:]
    np.testing.assert_allclose(pixel, CAMERA.pixel_of_tangents(POINTS[:, :2] / depth), atol=1e-9)
    by_intrinsics = POINTS[:, :2] * [1, -1] / depth * EYE.focal_px + EYE.centre_px
    np.testing.assert_allclose(pixel, by_intrinsics, atol=1e-9)


@pytest.mark.parametrize(("near", "far"), [(0.1, 50.0), (0.1, np.inf), (50.0, 0.1), (np.inf, 0.1)])
def test_the_depth_buffer_is_what_a_stored_depth_of_the_same_planes_says(near: float, far: float) -> None:
    stored = StoredDepth(DepthKind.WINDOW, near, far)
    at_0, at_1 = stored.inverse_of_0_and_1
    for window in (
        clip(EYE.projection(near, far, zero_to_one=True))[:, 2],
        0.5 + 0.5 * clip(EYE.projection(near, far))[:, 2],
    ):
        np.testing.assert_allclose(at_0 + (at_1 - at_0) * window, -1 / POINTS[:, 2], rtol=1e-9)


def test_the_borders_lie_at_the_angles_that_openxr_is_told() -> None:
    left, right, up, down = np.tan(EYE.fov_rad)
    corners = np.array([[left, up, -1, 1], [right, down, -1, 1]]) @ EYE.projection(0.1).T
    np.testing.assert_allclose(corners[:, :2] / corners[:, 3:], [[-1, 1], [1, -1]], atol=1e-12)


def test_its_pose_in_openxrs_form_takes_points_to_the_world() -> None:
    """By the formula of a unit quaternion, v + 2 q x (q x v + w v)."""
    (*vector, w), points = EYE.orientation_xyzw, POINTS
    turned = points + 2 * np.cross(vector, np.cross(vector, points) + w * points)
    np.testing.assert_allclose(turned + EYE.position, transforms.apply(EYE.world_from_camera, points), atol=1e-12)


def test_the_view_matrix_carries_the_cameras_place_to_the_origin() -> None:
    eye_in_world = transforms.apply(HEAD, np.array([-0.03, 0.0, 0.01]))
    np.testing.assert_allclose(transforms.apply(EYE.camera_from_world, eye_in_world), 0, atol=1e-12)
    np.testing.assert_allclose(EYE.camera_from_world @ EYE.world_from_camera, np.eye(4), atol=1e-12)


@pytest.mark.parametrize(("near", "far"), [(0.0, 1.0), (0.1, 0.1), (np.inf, np.inf), (-1.0, 5.0), (np.nan, 1.0)])
def test_planes_that_bound_nothing_are_refused(near: float, far: float) -> None:
    with pytest.raises(BadInputError, match="two different positive distances"):
        EYE.projection(near, far)


def test_what_an_engine_is_told_it_cannot_change() -> None:
    with pytest.raises(ValueError, match="read-only"):
        EYE.world_from_camera[:3, 3] += 1.0


def pose(rng: np.random.Generator) -> FloatArray:
    return transforms.rigid(transforms.rotations_of_vectors(rng.normal(size=3)), rng.normal(size=3))


@pytest.mark.parametrize("lead", [(), (1,), (3, 1, 2)])
def test_a_point_is_the_same_world_point_by_both_ways(lead: tuple[int, ...]) -> None:
    rng = np.random.default_rng(4)
    view = View(OFF_CENTRE, rng.normal(size=3), pose(rng), pose(rng)[:3, :3])
    viewpoint, axes = rng.normal(size=3), pose(rng)[:3, :3]
    poses = np.array([pose(rng) for _ in range(int(np.prod(lead)))]).reshape(*lead, 4, 4)
    carried = image_from_ray_map(view, viewpoint, axes, poses)
    assert carried.shape == (*lead, 4, 4)
    point_in_field = rng.normal(size=3)
    for place in np.ndindex(lead):
        point_in_device = viewpoint + axes @ point_in_field
        point_in_world = transforms.apply(poses[place], point_in_device)
        seen = transforms.apply(view.world_from_camera, transforms.apply(carried[place], point_in_field))
        np.testing.assert_allclose(seen, point_in_world, atol=1e-12)
