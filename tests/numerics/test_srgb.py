import numpy as np
import pytest

from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.srgb import decode_srgb, encode_srgb


def curve(linear: FloatArray) -> FloatArray:
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def test_round_trip_over_all_codes() -> None:
    codes = np.arange(256, dtype=np.uint8)
    np.testing.assert_array_equal(encode_srgb(decode_srgb(codes)), codes)


def test_decoding_inverts_the_standard_curve() -> None:
    codes = np.arange(256, dtype=np.uint8)
    np.testing.assert_allclose(curve(decode_srgb(codes).astype(float)) * 255, codes, atol=2e-3)


def test_encoding_is_within_rounding_of_the_standard_curve() -> None:
    # Densest near black, where the curve is steepest.
    linear = (np.linspace(0, 1, 300_001) ** 3).astype(np.float32)
    error = np.abs(encode_srgb(linear) - 255 * curve(linear.astype(float)))
    assert error.max() < 0.53


def test_light_beyond_the_display_is_clipped() -> None:
    assert encode_srgb(np.array([-1.0, 0.0, 1.0, 7.0], np.float32)).tolist() == [0, 0, 255, 255]


@pytest.mark.parametrize("shape", [(), (1,), (3, 1, 2)])
def test_any_shape(shape: tuple[int, ...]) -> None:
    assert encode_srgb(np.full(shape, 0.5, np.float32)).shape == shape
    assert decode_srgb(np.full(shape, 9, np.uint8)).shape == shape
