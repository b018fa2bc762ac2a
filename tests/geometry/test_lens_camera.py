"""A camera with distortion against OpenCV's, and there and back."""

import cv2
import numpy as np
import pytest

from wlr_render.geometry.lens_camera import OPENCV_PIXEL_SHIFT, LensCamera


@pytest.fixture
def camera():
    return LensCamera(
        (1280, 1024),
        np.array([1400.0, 1395.0]),
        np.array([650.0, 500.0]),
        np.array([-0.21, 0.11, 1e-3, -7e-4, -0.03]),
    )


def test_points_are_seen_where_opencv_sees_them(camera):
    points = np.random.default_rng(1).uniform([-0.4, -0.3, 0.9], [0.4, 0.3, 1.4], (50, 3))
    seen, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), camera.opencv_matrix, camera.distortion)
    assert np.allclose(camera.pixel_of_point(points) + OPENCV_PIXEL_SHIFT, seen[:, 0], atol=1e-9)


@pytest.mark.parametrize("shape", [(), (1,), (3, 1, 2)])
def test_pixels_and_tangents_are_inverse(camera, shape):
    pixel = np.random.default_rng(2).uniform(0, 1, (*shape, 2)) * camera.size_px
    assert np.allclose(camera.pixel_of_tangents(camera.tangents_of_pixel(pixel)), pixel, atol=1e-8)
    assert np.allclose(np.linalg.norm(camera.dir_of_pixel(pixel), axis=-1), 1.0)


def test_points_behind_the_camera_have_no_pixel(camera):
    assert np.isnan(camera.pixel_of_point(np.array([0.1, 0.1, -1.0]))).all()


def test_a_lens_that_folds_has_no_direction_beyond_its_fold():
    folding = LensCamera(
        (1000, 1000), np.array([500.0, 500.0]), np.array([500.0, 500.0]), np.array([-0.6, 0, 0, 0, 0.0])
    )
    assert np.isnan(folding.tangents_of_pixel(np.array([999.0, 999.0]))).all()
    assert np.isfinite(folding.tangents_of_pixel(np.array([600.0, 600.0]))).all()
