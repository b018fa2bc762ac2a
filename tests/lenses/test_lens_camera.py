"""Cameras of all kinds of lenses against OpenCV's, their derivatives, inverses and limits."""

from collections.abc import Sequence

import cv2
import numpy as np
import pytest

from wlr_render.errors import BadInputError
from wlr_render.lenses.lens_camera import LENS_KINDS, OPENCV_PIXEL_SHIFT, LensCamera
from wlr_render.numerics.arrays import FloatArray

_BROWN = np.array([-0.21, 0.11, 1e-3, -7e-4, -0.03])
_STILL = np.zeros(3)


@pytest.fixture
def camera() -> LensCamera:
    return LensCamera((1280, 1024), np.array([1400.0, 1395.0]), np.array([650.0, 500.0]), _BROWN)


def wide(kind: str) -> LensCamera:
    """A lens that sees at least 120 degrees along the picture's diagonal and has all terms of its kind."""
    # A rational function that equals the angle up to 70 degrees, as f-theta lenses have it, and some decentring
    rational = np.array([0.8318, 0.1270, 2e-4, -3e-4, 0.0018, 1.1651, 0.3160, 0.0153])
    terms = {
        "brown": np.array([-0.07, 0.012, 2e-4, -3e-4, -4e-4]),
        "rational": rational,
        "thin-prism": np.append(rational, [3e-4, -1e-5, -2e-4, 2e-5]),
        "fisheye": np.array([-0.011, 0.004, -0.0013, 1e-4]),
    }[kind]
    focal = {"brown": 350.0, "fisheye": 320.0}.get(kind, 720.0)
    return LensCamera((1280, 1024), np.array([focal, focal + 2]), np.array([650.0, 500.0]), terms, kind)


def directions_within(angle_deg: float, count: int = 200, seed: int = 1) -> FloatArray:
    random = np.random.default_rng(seed)
    angle, turn = np.radians(random.uniform(0, angle_deg, count)), random.uniform(0, 2 * np.pi, count)
    side = np.stack([np.cos(turn), np.sin(turn)], axis=1) * np.sin(angle)[:, None]
    return np.column_stack([side, np.cos(angle)]) * random.uniform(0.5, 3.0, (count, 1))


def pictures_pixels(camera: LensCamera) -> FloatArray:
    """Pixels over the whole picture, its corners included."""
    width, height = camera.size_px
    u, v = np.meshgrid(np.linspace(0, width, 41), np.linspace(0, height, 33))
    return np.stack([u, v], axis=-1)


@pytest.mark.parametrize("kind", ["brown", "rational", "thin-prism"])
def test_points_are_seen_where_opencv_sees_them(kind: str) -> None:
    camera = wide(kind)
    points = directions_within(62)
    seen, _ = cv2.projectPoints(points, _STILL, _STILL, camera.opencv_matrix, camera.distortion)
    assert np.abs(camera.pixel_of_point(points) + OPENCV_PIXEL_SHIFT - seen[:, 0]).max() < 1e-9


def test_points_in_a_fisheye_lens_are_seen_where_opencv_sees_them() -> None:
    camera = wide("fisheye")
    points = directions_within(80)
    seen, _ = cv2.fisheye.projectPoints(points[None], _STILL, _STILL, camera.opencv_matrix, camera.distortion)
    assert np.abs(camera.pixel_of_point(points) + OPENCV_PIXEL_SHIFT - seen[0]).max() < 1e-9


def test_a_fisheye_lens_sees_behind_itself() -> None:
    camera = wide("fisheye")
    angle = np.radians([89.0, 90.0, 91.0, 100.0])
    points = np.stack([0.6 * np.sin(angle), -0.8 * np.sin(angle), np.cos(angle)], axis=1)
    radius = angle * (1 + camera.distortion @ np.stack([angle**2, angle**4, angle**6, angle**8]))
    expected = camera.centre_px + camera.focal_px * radius[:, None] * [0.6, -0.8]
    assert np.abs(camera.pixel_of_point(points) - expected).max() < 1e-10
    assert np.abs(camera.dir_of_pixel(expected) - points).max() < 1e-12
    assert np.isnan(camera.tangents_of_pixel(expected)[2:]).all()
    assert np.isnan(camera.pixel_of_point(np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 0.0]]))).all()


@pytest.mark.parametrize("kind", LENS_KINDS)
def test_derivatives_are_those_of_the_projection(kind: str) -> None:
    camera = wide(kind)
    points = np.vstack([directions_within(62, 20), [0.0, 0.0, 2.0]])
    projection = camera.project(points)
    assert np.allclose(projection.pixel, camera.pixel_of_point(points), atol=1e-12)

    step = 1e-6
    by_point = [(camera.pixel_of_point(points + d) - camera.pixel_of_point(points - d)) for d in step * np.eye(3)]
    assert np.allclose(projection.by_point, np.stack(by_point, axis=2) / (2 * step), atol=1e-4, rtol=1e-7)
    assert projection.by_values.shape == (21, 2, len(camera.names))
    for column, name in enumerate(camera.names):
        change = step * (np.arange(len(camera.names)) == column)
        ahead, back = (camera.with_values(camera.values + sign * change).pixel_of_point(points) for sign in (1, -1))
        difference = (ahead - back) / (2 * step)
        assert np.allclose(projection.by_values[:, :, column], difference, atol=1e-4, rtol=1e-6), name


@pytest.mark.parametrize("kind", LENS_KINDS)
def test_every_pixel_of_a_wide_picture_has_a_direction_and_returns(kind: str) -> None:
    camera = wide(kind)
    pixel = pictures_pixels(camera)
    direction = camera.dir_of_pixel(pixel)
    assert np.degrees(np.arccos(direction[..., 2].min())) > 60
    back = camera.pixel_of_point(direction)
    assert np.abs((back - pixel) / camera.focal_px).max() < 2e-12
    assert np.allclose(np.linalg.norm(direction, axis=-1), 1.0)


@pytest.mark.parametrize("shape", [(), (1,), (3, 1, 2), (0,)])
def test_pixels_and_tangents_are_inverse(camera: LensCamera, shape: tuple[int, ...]) -> None:
    pixel = np.random.default_rng(2).uniform(0, 1, (*shape, 2)) * camera.size_px
    assert np.allclose(camera.pixel_of_tangents(camera.tangents_of_pixel(pixel)), pixel, atol=1e-8)
    assert np.allclose(np.linalg.norm(camera.dir_of_pixel(pixel), axis=-1), 1.0)


@pytest.mark.parametrize("kind", ["brown", "rational", "thin-prism"])
def test_points_behind_a_perspective_camera_have_no_pixel(kind: str) -> None:
    points = np.array([[0.1, 0.1, -1.0], [0.1, 0.1, 0.0], [0.1, 0.1, 1.0]])
    projection = wide(kind).project(points)
    assert np.isnan(projection.pixel[:2]).all()
    assert np.isnan(projection.by_point[:2]).all()
    assert np.isnan(projection.by_values[:2]).all()
    assert np.isfinite(projection.by_values[2]).all()


@pytest.mark.parametrize(
    ("kind", "terms", "limit_deg"),
    [
        ("brown", [-0.6, 0, 0, 0, 0], np.degrees(np.arctan(np.sqrt(1 / 1.8)))),  # 1 = 3 * 0.6 r^2
        ("rational", [0, 0, 0, 0, 0, 1, 0, 0], 45.0),  # r / (1 + r^2) turns back at 1
        ("rational", [0, 0, 0, 0, 0, -1, 0, 0], 45.0),  # r / (1 - r^2) has its pole at 1
        ("brown", [0, 0, 0, 0.01, 0], np.degrees(np.arctan(1 / 0.06))),  # y (1 + 6 * 0.01 y) folds at y = -1 / 0.06
        ("fisheye", [-0.5, 0, 0, 0], np.degrees(np.sqrt(1 / 1.5))),
        ("brown", [0, 0, 0, 0, 0], 90.0),
        ("fisheye", [0, 0, 0, 0], 180.0),
    ],
)
def test_a_lens_that_folds_sees_nothing_from_its_fold_on(kind: str, terms: Sequence[float], limit_deg: float) -> None:
    camera = LensCamera((1000, 1000), np.full(2, 500.0), np.full(2, 500.0), np.array(terms, dtype=float), kind)
    assert np.degrees(camera.angle_limit) == pytest.approx(limit_deg, abs=1e-9)
    angle = np.radians(limit_deg) * np.array([0.0, 0.999, 1.001, 1.1, 1.5])
    angle = angle[angle <= np.pi]
    seen = camera.pixel_of_point(np.stack([np.sin(angle), np.zeros_like(angle), np.cos(angle)], axis=1))
    assert np.isfinite(seen[:2]).all()
    assert np.isnan(seen[2:]).all()


def test_pixels_beyond_the_fold_have_no_direction() -> None:
    folding = LensCamera((1000, 1000), np.full(2, 500.0), np.full(2, 500.0), np.array([-0.6, 0, 0, 0, 0.0]))
    assert np.isnan(folding.tangents_of_pixel(np.array([999.0, 999.0]))).all()
    assert np.isfinite(folding.tangents_of_pixel(np.array([600.0, 600.0]))).all()


def test_decentring_never_folds_within_the_limit() -> None:
    random = np.random.default_rng(3)
    for _ in range(20):
        terms = random.normal(0, [0.2, 0.1, 0.02, 0.02, 0.02, 0.2, 0.1, 0.02, 0.02, 0.01, 0.02, 0.01])
        camera = LensCamera((1000, 1000), np.ones(2), np.zeros(2), terms, "thin-prism")
        points = directions_within(np.degrees(camera.angle_limit) * 0.9999, 300)
        assert (np.linalg.det(camera.project(points).by_point[:, :, :2]) > 0).all()


def test_values_make_the_same_camera_again() -> None:
    camera = wide("rational")
    again = LensCamera((1280, 1024), np.ones(2), np.zeros(2), np.zeros(8), "rational").with_values(camera.values)
    assert np.array_equal(again.values, camera.values)
    assert again.kind == "rational"
    assert again.names == ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")


def test_distortion_terms_that_do_not_fit_the_kind_are_refused() -> None:
    with pytest.raises(BadInputError, match=r"'fisheye' has 4 distortion terms \(k1, k2, k3, k4\), not 5"):
        LensCamera((10, 10), np.ones(2), np.zeros(2), np.zeros(5), "fisheye")
    with pytest.raises(BadInputError, match="unknown kind of lens 'fish'; choose one of brown, rational"):
        LensCamera((10, 10), np.ones(2), np.zeros(2), np.zeros(4), "fish")
