"""A lens with a smooth field over its picture, against differences and its own inverse."""

from dataclasses import replace

import numpy as np

from wlr_render.lenses.lens_camera import LensCamera
from wlr_render.lenses.residual_lens import ResidualLens
from wlr_render.numerics.arrays import FloatArray

_MODEL = LensCamera(
    (1600, 1200), np.array([1110.0, 1112.0]), np.array([805.0, 596.0]), np.array([-0.1, 0.03, 5e-4, -3e-4, 0.0])
)


def lens(size_px: float = 0.5) -> ResidualLens:
    plain = ResidualLens.of(_MODEL)
    shape = plain.residual_px.shape
    amplitude = np.random.default_rng(3).normal(size=shape) * plain.field.sizes[:, None]
    return replace(plain, residual_px=size_px * amplitude)


def points(count: int = 60) -> FloatArray:
    rng = np.random.default_rng(4)
    return np.column_stack([rng.uniform(-0.6, 0.6, count), rng.uniform(-0.4, 0.4, count), np.ones(count)])


def test_the_field_has_its_size_and_none_displaces_nothing() -> None:
    assert 0.3 < lens(0.5).rms_px < 0.8
    plain = ResidualLens.of(_MODEL)
    np.testing.assert_array_equal(plain.pixel_of_point(points()), _MODEL.pixel_of_point(points()))
    np.testing.assert_array_equal(
        plain.dir_of_pixel(np.array([[300.0, 500.0]])), _MODEL.dir_of_pixel(np.array([[300.0, 500.0]]))
    )


def test_directions_invert_pixels() -> None:
    bent, point = lens(), points()
    pixel = bent.pixel_of_point(point)
    assert np.abs(pixel - _MODEL.pixel_of_point(point)).max() > 0.5
    np.testing.assert_allclose(bent.tangents_of_pixel(pixel), point[:, :2], atol=1e-12)
    direction = bent.dir_of_pixel(pixel.reshape(6, 10, 2))
    np.testing.assert_allclose(direction[..., :2] / direction[..., 2:], point[:, :2].reshape(6, 10, 2), atol=1e-12)


def test_derivatives_are_those_of_differences() -> None:
    bent, point = lens(), points()
    found = bent.project(point)
    np.testing.assert_allclose(found.pixel, bent.pixel_of_point(point), atol=1e-12)
    for axis, step in enumerate(1e-6 * np.eye(3)):
        change = (bent.pixel_of_point(point + step) - bent.pixel_of_point(point - step)) / 2e-6
        np.testing.assert_allclose(found.by_point[:, :, axis], change, atol=2e-4)
    for number in (0, 3, 5, 9, 40, len(bent.values) - 1):
        step = 1e-5 * (np.arange(len(bent.values)) == number)
        more, less = (bent.with_values(bent.values + sign * step).pixel_of_point(point) for sign in (1, -1))
        np.testing.assert_allclose(found.by_values[:, :, number], (more - less) / 2e-5, atol=2e-4)


def test_no_points_have_no_pixels_and_points_behind_the_camera_nan() -> None:
    bent = lens()
    assert bent.project(np.zeros((0, 3))).by_values.shape == (0, 2, len(bent.values))
    assert np.isnan(bent.pixel_of_point(np.array([0.0, 0.1, -1.0]))).all()
