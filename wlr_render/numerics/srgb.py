"""Convert between linear light and 8-bit sRGB (IEC 61966-2-1), by table."""

import numpy as np
from numpy.typing import NDArray

from wlr_render.numerics.arrays import Float32Array

_STEPS = (1 << 16) - 1


def _linear_of_srgb(encoded: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


def _srgb_of_linear(linear: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


_LINEAR_OF_CODE = _linear_of_srgb(np.arange(256) / 255).astype(np.float32)
_CODE_OF_STEP = np.rint(255 * _srgb_of_linear(np.arange(_STEPS + 1) / _STEPS)).astype(np.uint8)


def decode_srgb(code: NDArray[np.uint8]) -> Float32Array:
    """Decode 8-bit sRGB (...) to linear light 0..1, float32 (...)."""
    return _LINEAR_OF_CODE.take(code)


def encode_srgb(linear: Float32Array) -> NDArray[np.uint8]:
    """Encode finite linear light (...), clipped to 0..1, as 8-bit sRGB (...).

    A step of the table is at most 0.05 codes, so that the result is within 0.53 codes of the exact curve.
    """
    step = np.clip(linear, np.float32(0), np.float32(1))
    step *= np.float32(_STEPS)
    step += np.float32(0.5)
    return _CODE_OF_STEP.take(step.astype(np.intp))
