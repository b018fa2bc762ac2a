import numpy as np

from wlr_render.compositing.eye_camera import EyeCamera
from wlr_render.geometry import transforms
from wlr_render.geometry.pinhole import Pinhole
from wlr_render.rendering.view import View

CAMERA = Pinhole(640, 400, np.array([-0.5, -0.3]), np.array([0.7, 0.45]))
HEAD = transforms.rigid(transforms.rotation_about("y", 0.4), np.array([1.0, 1.6, -2.0]))
EYE = EyeCamera("left", View(CAMERA, np.array([-0.03, 0.0, 0.01]), HEAD, transforms.rotation_about("x", 0.1)))
POINTS = np.random.default_rng(0).uniform([-0.5, -0.4, -6], [0.7, 0.4, -0.4], (50, 3))  # camera frame


def clip(projection):
    homogeneous = np.concatenate([POINTS, np.ones((len(POINTS), 1))], axis=1) @ projection.T
    return homogeneous[:, :3] / homogeneous[:, 3:]


def test_the_projection_puts_points_on_the_pinholes_pixels():
    pixel = (clip(EYE.projection(0.1, 50.0))[:, :2] * [1, -1] + 1) / 2 * EYE.size_px
    depth = -POINTS[:, 2:]
    np.testing.assert_allclose(pixel, CAMERA.pixel_of_tangents(POINTS[:, :2] / depth), atol=1e-9)
    by_intrinsics = POINTS[:, :2] * [1, -1] / depth * EYE.focal_px + EYE.centre_px
    np.testing.assert_allclose(pixel, by_intrinsics, atol=1e-9)


def test_depth_runs_from_minus_one_at_the_near_plane_to_one_at_the_far_plane():
    for far in (50.0, np.inf):
        projection = EYE.projection(0.1, far)
        at_planes = np.array([[0, 0, -0.1, 1], [0, 0, -min(far, 1e12), 1]]) @ projection.T
        np.testing.assert_allclose(at_planes[:, 2] / at_planes[:, 3], [-1, 1], atol=1e-9)


def test_the_view_matrix_carries_the_cameras_place_to_the_origin():
    eye_in_world = transforms.apply(HEAD, np.array([-0.03, 0.0, 0.01]))
    np.testing.assert_allclose(transforms.apply(EYE.camera_from_world, eye_in_world), 0, atol=1e-12)
    np.testing.assert_allclose(EYE.camera_from_world @ EYE.world_from_camera, np.eye(4), atol=1e-12)
