from typing import Any

import numpy as np

from wlr_render.captures.patterns.pixel_rejection import fit_planes
from wlr_render.numerics.arrays import BoolArray, FloatArray


def slow(position: FloatArray, valid: BoolArray, row: int, column: int) -> tuple[Any, Any]:
    """Least squares at one pixel by numpy: value, slopes, and the variance of the value per unit variance."""
    rows, values = [], []
    for y in range(max(row - 1, 0), min(row + 2, valid.shape[0])):
        for x in range(max(column - 1, 0), min(column + 2, valid.shape[1])):
            if valid[y, x]:
                rows.append((1, x - column, y - row))
                values.append(position[:, y, x])
    design = np.array(rows, dtype=float)
    inverse = np.linalg.pinv(design.T @ design)
    return inverse @ design.T @ np.array(values), inverse[0, 0]


def test_it_is_least_squares_at_every_valid_pixel() -> None:
    rng = np.random.default_rng(2)
    position, valid = rng.normal(0, 5, (2, 12, 15)), rng.random((12, 15)) < 0.7
    fit = fit_planes(position, valid)
    for row, column in np.argwhere(valid):
        expected, gain = slow(position, valid, row, column)
        np.testing.assert_allclose(fit.value[:, row, column], expected[0], atol=1e-6)
        np.testing.assert_allclose(fit.slope[:, :, row, column], expected[1:].T, atol=1e-6)
        np.testing.assert_allclose(fit.gain[row, column], gain, atol=1e-6)


def test_what_is_not_valid_does_not_count() -> None:
    rng = np.random.default_rng(3)
    position, valid = rng.normal(0, 5, (2, 9, 9)), rng.random((9, 9)) < 0.6
    spoilt = np.where(valid, position, 1e6)
    assert np.array_equal(fit_planes(position, valid).value[:, valid], fit_planes(spoilt, valid).value[:, valid])
