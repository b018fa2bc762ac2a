from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from wlr_render.numerics.arrays import FloatArray
from wlr_render.simulation.photographs.pixel_map import PixelMap

SIZE = (150, 90)
OFFSET = np.array([0.3, -0.2])
TOLERANCE = np.array([1e-3, 1e-3])


def places() -> FloatArray:
    u, v = np.meshgrid(np.arange(SIZE[0]) + 0.5, np.arange(SIZE[1]) + 0.5)
    return np.asarray(np.stack([u, v], axis=-1) + OFFSET)


def smooth(place: FloatArray) -> tuple[NDArray[Any], NDArray[Any]]:
    u, v = place[..., 0] / 100, place[..., 1] / 100
    return np.stack([100 * np.sin(u + v), 50 * u * np.exp(v)], axis=-1), np.ones(place.shape[:-1], bool)


def behind_a_round_hole(place: FloatArray) -> tuple[NDArray[Any], Any]:
    """Light within a circle; far outside it there is not even a value."""
    value, _ = smooth(place)
    radius = np.hypot(place[..., 0] - 70, place[..., 1] - 40)
    return np.where((radius < 60)[..., None], value, np.nan), radius < 35


def bent_along_a_line(place: FloatArray) -> tuple[Any, Any]:
    value, lit = smooth(place)
    return value + np.abs(place[..., :1] - 61.7), lit


@pytest.mark.parametrize("exact", [smooth, behind_a_round_hole, bent_along_a_line])
def test_every_pixel_has_its_exact_value_and_light(exact: Callable[..., Any]) -> None:
    field = PixelMap.sample(exact, SIZE, OFFSET, TOLERANCE)
    value, lit = exact(places())
    np.testing.assert_array_equal(field.lit, lit)
    error = np.abs(np.moveaxis(field.planes(), 0, -1) - value)[lit]
    assert error.max() < 1.5e-3


def test_few_pixels_are_computed_one_by_one_where_it_is_smooth() -> None:
    assert len(PixelMap.sample(smooth, SIZE, OFFSET, TOLERANCE).alone) == 0
    bent = PixelMap.sample(bent_along_a_line, (600, 40), OFFSET, TOLERANCE)
    assert 0 < len(bent.alone) < 0.25 * 600 * 40


def test_a_picture_without_light_is_dark_everywhere() -> None:
    field = PixelMap.sample(
        lambda place: (np.full((*place.shape[:-1], 2), np.nan), np.zeros(place.shape[:-1], bool)),
        (7, 3),
        np.zeros(2),
        TOLERANCE,
    )
    assert not field.lit.any()
