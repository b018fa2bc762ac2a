"""mrcal's splined lens model against an evaluation of its B-splines by the textbook, and without a spline."""

import numpy as np
import pytest

from wlr_render.errors import BadInputError
from wlr_render.lenses.splined_lens import SplinedLens
from wlr_render.numerics.arrays import FloatArray

_SIZE, _FOCAL, _CENTRE = (3000, 2000), np.array([1500.0, 1510.0]), np.array([1500.0, 990.0])
_COUNTS = {2: (13, 10), 3: (14, 11)}
_FOV_DEG = 150.0


def lens(order: int, amplitude: float = 0.02) -> SplinedLens:
    nx, ny = _COUNTS[order]
    control = np.random.default_rng(order).normal(0.0, amplitude, (ny, nx, 2))
    return SplinedLens(_SIZE, _FOCAL, _CENTRE, control, order, _FOV_DEG)


def directions_within(angle_deg: int, count: int = 100) -> FloatArray:
    random = np.random.default_rng(4)
    angle, turn = np.radians(random.uniform(0, angle_deg, count)), random.uniform(0, 2 * np.pi, count)
    return np.stack([np.sin(angle) * np.cos(turn), 0.6 * np.sin(angle) * np.sin(turn), np.cos(angle)], axis=1)


def basis(order: int, x: float) -> float:
    """Uniform B-spline centred at 0, piece by piece as textbooks give it."""
    x = abs(x)
    if order == 3:
        return 2 / 3 - x**2 + x**3 / 2 if x < 1 else max(2 - x, 0) ** 3 / 6
    return 3 / 4 - x**2 if x < 0.5 else max(1.5 - x, 0) ** 2 / 2


def pixel_by_the_book(lens: SplinedLens, point: FloatArray) -> FloatArray:
    x, y, z = point
    u = np.array([x, y]) * 2 / (np.linalg.norm(point) + z)
    ny, nx, _ = lens.control.shape
    intervals = nx - 3 if lens.order == 3 else nx - 2  # those that the field of view spans
    per_unit = intervals / (4 * np.tan(np.radians(lens.fov_x_deg) / 4))
    shift = sum(
        basis(lens.order, u[0] * per_unit + (nx - 1) / 2 - column)
        * basis(lens.order, u[1] * per_unit + (ny - 1) / 2 - row)
        * lens.control[row, column]
        for row in range(ny)
        for column in range(nx)
    )
    return np.asarray(lens.focal_px * (u + shift) + lens.centre_px)


@pytest.mark.parametrize("order", [2, 3])
def test_pixels_are_those_of_the_textbook(order: int) -> None:
    points = directions_within(70)
    expected = np.array([pixel_by_the_book(lens(order), point) for point in points])
    assert np.abs(lens(order).pixel_of_point(2.5 * points) - expected).max() < 1e-9


@pytest.mark.parametrize("order", [2, 3])
def test_without_shift_it_is_the_stereographic_projection(order: int) -> None:
    plain = lens(order, amplitude=0.0)
    points = directions_within(70)
    angle = np.arccos(points[:, 2] / np.linalg.norm(points, axis=1))
    away = points[:, :2] / np.linalg.norm(points[:, :2], axis=1)[:, None]
    expected = _CENTRE + _FOCAL * away * 2 * np.tan(angle / 2)[:, None]
    assert np.abs(plain.pixel_of_point(points) - expected).max() < 1e-9


@pytest.mark.parametrize("order", [2, 3])
def test_every_pixel_of_the_picture_has_a_direction_and_returns(order: int) -> None:
    u, v = np.meshgrid(np.linspace(0, 3000, 31), np.linspace(0, 2000, 21))
    pixel = np.stack([u, v], axis=-1)
    wavy = lens(order)
    direction = wavy.dir_of_pixel(pixel)
    assert np.degrees(np.arccos(direction[..., 2].min())) > 60
    assert np.abs((wavy.pixel_of_point(direction) - pixel) / _FOCAL).max() < 2e-12
    assert np.allclose(wavy.pixel_of_tangents(wavy.tangents_of_pixel(pixel)), pixel, atol=1e-8)
    assert np.isnan(wavy.dir_of_pixel(np.array([1e6, 0.0]))).all()


@pytest.mark.parametrize("order", [2, 3])
def test_derivatives_are_those_of_the_projection(order: int) -> None:
    wavy, points, step = lens(order), directions_within(70, 20), 1e-6
    differences = [wavy.pixel_of_point(points + d) - wavy.pixel_of_point(points - d) for d in step * np.eye(3)]
    projection = wavy.project(points)
    assert np.allclose(projection.by_point, np.stack(differences, axis=2) / (2 * step), atol=1e-3, rtol=1e-6)
    assert np.array_equal(projection.pixel, wavy.pixel_of_point(points))
    assert projection.by_values.shape == (20, 2, 0)
    assert wavy.names == ()
    assert wavy.values.shape == (0,)


def test_points_beyond_the_knots_and_in_folds_are_not_seen() -> None:
    assert np.isnan(lens(3).pixel_of_point(np.array([[np.sin(1.32), 0, np.cos(1.32)], [0, 0, -1], [0, 0, 0]]))).all()
    nx, ny = _COUNTS[3]
    turning = np.zeros((ny, nx, 2))
    turning[:, :, 0] = -0.9 * np.maximum(np.arange(nx) - 9, 0)  # the surface turns back to the left at its right end
    folded = SplinedLens(_SIZE, _FOCAL, _CENTRE, turning, 3, _FOV_DEG)
    seen = folded.pixel_of_point(np.array([[np.sin(0.3), 0, np.cos(0.3)], [np.sin(1.2), 0, np.cos(1.2)]]))
    assert np.isfinite(seen[0]).all()
    assert np.isnan(seen[1]).all()


def test_bad_splines_are_refused() -> None:
    for control, order, sentence in [
        (np.zeros((5, 5, 2)), 4, "order 2 or 3, not 4"),
        (np.zeros((3, 5, 2)), 3, "at least 4 x 4 control points"),
    ]:
        with pytest.raises(BadInputError, match=sentence):
            SplinedLens(_SIZE, _FOCAL, _CENTRE, control, order, _FOV_DEG)
