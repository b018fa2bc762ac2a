"""A plane through the panel positions of each camera pixel and its neighbours."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from wlr_render.numerics.arrays import FloatArray

WINDOW = 3
"""Width of the window, camera pixels."""

_FLAT: FloatArray = np.ones(WINDOW)
_RAMP: FloatArray = np.arange(WINDOW, dtype=np.float64) - (WINDOW - 1) / 2
_RIDGE = 1e-9  # a window of one row has no slope across; without effect on others


@dataclass(frozen=True, eq=False)
class LocalFit:
    """Weighted least squares with weight 1 where valid, 0 elsewhere.

    Attributes:
        value: (2, h, w) the plane at the pixel.
        slope: (2, 2, h, w) its change per camera pixel; slope[i, j] of panel axis i along axis j of the picture (x, y).
        gain: (h, w) variance of `value` over that of one position: 1/9 in a full window.
    """

    value: FloatArray
    slope: FloatArray
    gain: FloatArray


def fit_planes(position: FloatArray, valid: NDArray[np.bool_]) -> LocalFit:
    """Fit all pixels at once.

    Args:
        position: (2, h, w), finite everywhere.
        valid: (h, w) which positions count; results mean something only there.
    """
    inverse = _inverse_moments(valid.astype(np.float64))
    fits = np.array([_solve(inverse, np.where(valid, axis, 0.0)) for axis in position])  # (2, 3, h, w)
    return LocalFit(fits[:, 0], fits[:, 1:], inverse[0])


def _inverse_moments(weight: FloatArray) -> tuple[FloatArray, ...]:
    """Upper triangle, row by row, of the inverse of the matrix of moments of (1, x, y)."""
    square = _RAMP * _RAMP
    n, x, y = (_sum(weight, *kernels) for kernels in ((_FLAT, _FLAT), (_RAMP, _FLAT), (_FLAT, _RAMP)))
    xx, yy = _sum(weight, square, _FLAT) + _RIDGE, _sum(weight, _FLAT, square) + _RIDGE
    xy = _sum(weight, _RAMP, _RAMP)
    first = xx * yy - xy * xy, xy * y - x * yy, x * xy - xx * y
    determinant = n * first[0] + x * first[1] + y * first[2]
    scale = 1 / np.where(determinant > 0, determinant, np.inf)
    rest = n * yy - y * y, x * y - n * xy, n * xx - x * x
    return tuple(entry * scale for entry in (*first, *rest))


def _solve(inverse: tuple[FloatArray, ...], value: FloatArray) -> FloatArray:
    i00, i01, i02, i11, i12, i22 = inverse
    s, sx, sy = (_sum(value, *kernels) for kernels in ((_FLAT, _FLAT), (_RAMP, _FLAT), (_FLAT, _RAMP)))
    return np.array([i00 * s + i01 * sx + i02 * sy, i01 * s + i11 * sx + i12 * sy, i02 * s + i12 * sx + i22 * sy])


def _sum(image: FloatArray, along_x: FloatArray, along_y: FloatArray) -> FloatArray:
    return np.asarray(cv2.sepFilter2D(image, -1, along_x, along_y, borderType=cv2.BORDER_CONSTANT))
