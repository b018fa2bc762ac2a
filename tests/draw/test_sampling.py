from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy import number
from numpy.typing import NDArray

from wlr_render.draw.sampling import remap
from wlr_render.errors import BadInputError
from wlr_render.numerics.arrays import Float32Array, FloatArray

RNG = np.random.default_rng(11)


def image_of(
    height: int, width: int, channels: int | None, kind: Callable[..., Any] | type[number]
) -> Float32Array | NDArray[np.uint8]:
    shape = (height, width) if channels is None else (height, width, channels)
    return RNG.integers(0, 256, shape).astype(np.uint8) if kind is np.uint8 else RNG.random(shape, dtype=np.float32)


def centres(height: int, width: int) -> FloatArray:
    return np.stack(np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5), axis=-1)


def plain_bilinear(image: FloatArray, u: float, v: float) -> float:
    """One position, in float64; the border's pixels go on outwards."""
    height, width = image.shape[:2]
    column, row = int(np.floor(u - 0.5)), int(np.floor(v - 0.5))
    across, down = u - 0.5 - column, v - 0.5 - row
    total = 0.0
    for i, weight_i in ((row, 1 - down), (row + 1, down)):
        for j, weight_j in ((column, 1 - across), (column + 1, across)):
            total = total + weight_i * weight_j * image[np.clip(i, 0, height - 1), np.clip(j, 0, width - 1)]
    return total


@pytest.mark.parametrize("kind", [np.uint8, np.float32])
@pytest.mark.parametrize("channels", [None, 1, 3, 4])
def test_the_identity_changes_no_bit(channels: int | None, kind: type[number]) -> None:
    image = image_of(13, 17, channels, kind)
    sampled, inside = remap(image, centres(13, 17))
    np.testing.assert_array_equal(sampled, image)
    assert sampled.dtype == kind
    assert inside.all()


@pytest.mark.parametrize(("kind", "tolerance"), [(np.float32, 1e-6), (np.uint8, 0.51)])
@pytest.mark.parametrize("channels", [None, 3])
def test_bilinear_is_the_plain_one(kind: type[number], tolerance: float, channels: int | None) -> None:
    image = image_of(12, 10, channels, kind)
    position = RNG.uniform(0, [10, 12], (300, 2)).astype(np.float32)
    sampled, inside = remap(image, position)
    expected = [plain_bilinear(image.astype(float), *place) for place in position.astype(float)]
    np.testing.assert_allclose(sampled.astype(float), expected, atol=tolerance)
    assert inside.all()


def test_the_border_is_the_outer_edge_of_the_outermost_pixels() -> None:
    image = np.array([[1, 2], [3, 4]], np.float32)
    position = np.array([[0, 0], [2, 2], [2, 0], [-1e-3, 1], [1, 2.001], [np.nan, 1], [1, np.nan]])
    sampled, inside = remap(image, position, background=np.nan)
    np.testing.assert_array_equal(sampled, [1, 4, 2, np.nan, np.nan, np.nan, np.nan])
    np.testing.assert_array_equal(inside, [True, True, True, False, False, False, False])


def test_a_background_per_channel() -> None:
    sampled, _ = remap(image_of(4, 4, 3, np.uint8), np.full((2, 2), np.nan), background=(1, 2, 3))
    np.testing.assert_array_equal(sampled, [[1, 2, 3], [1, 2, 3]])


@pytest.mark.parametrize("shape", [(), (1,), (3, 1, 2), (0,), (5000,)])
def test_any_leading_shape(shape: tuple[int, ...]) -> None:
    image = image_of(6, 7, 3, np.float32)
    position = RNG.uniform(0, 6, (*shape, 2))
    sampled, inside = remap(image, position, 0)
    assert sampled.shape == (*shape, 3)
    assert inside.shape == shape
    one_by_one = [remap(image, place, 0)[0] for place in position.reshape(-1, 2)[:20]]
    np.testing.assert_array_equal(sampled.reshape(-1, 3)[:20], np.reshape(one_by_one, (-1, 3)))


def test_pictures_wider_than_opencv_allows_are_cut_up() -> None:
    image = image_of(2, 3, 3, np.uint8)
    position = np.tile(np.array([[0.5, 0.5], [1.5, 0.5], [2.5, 1.5]]), (15_000, 1))[None]
    sampled, _ = remap(image, position)
    np.testing.assert_array_equal(sampled[0, -3:], image[[0, 0, 1], [0, 1, 2]])


@pytest.mark.parametrize(
    ("image", "words"),
    [
        (np.zeros((4, 4, 2), np.float32), "1, 3 or 4 channels"),
        (np.zeros((4, 4)), "float64"),
        (np.zeros((4, 4), np.int16), "int16"),
        (np.zeros((1, 40_000), np.uint8), "cut it into tiles"),
        (np.zeros((0, 4), np.uint8), "1 to 32766"),
    ],
)
def test_images_that_opencv_would_sample_wrongly_are_refused(image: NDArray[Any], words: str) -> None:
    with pytest.raises(BadInputError, match=words):
        remap(image, np.zeros((3, 2)))
