"""The bias of a disc's picture against the ellipse in closed form, and maps that are polynomials."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from wlr_render.captures.boards.lattice_shape import lattice_shape
from wlr_render.numerics.arrays import IntArray

GRID = np.stack(np.meshgrid(np.arange(9), np.arange(8)), axis=-1).reshape(-1, 2)
PERSPECTIVE = np.array([[41.0, 3.0, 100.0], [-2.0, 25.0, 80.0], [0.012, 0.018, 1.0]])


def ellipse_centre(homography: NDArray[Any], centre: IntArray, radius: float) -> NDArray[Any]:
    """Centre of the conic that is the picture of a circle."""
    x, y = centre
    circle = np.array([[1, 0, -x], [0, 1, -y], [-x, -y, x * x + y * y - radius**2]])
    back = np.linalg.inv(homography)
    conic = back.T @ circle @ back
    return np.linalg.solve(conic[:2, :2], -conic[:2, 2])


def test_the_bias_of_a_perspective_view_is_that_of_the_ellipse() -> None:
    radius = np.where(np.arange(len(GRID)) % 3 == 0, 0.3, 0.19)
    seen = np.array([ellipse_centre(PERSPECTIVE, at, r) for at, r in zip(GRID, radius, strict=True)])
    lifted = np.concatenate([GRID, np.ones((len(GRID), 1))], axis=1) @ PERSPECTIVE.T
    bias = seen - lifted[:, :2] / lifted[:, 2:]
    assert np.abs(bias).max() > 0.03, "nothing to be corrected"
    assert np.abs(lattice_shape(GRID, seen).centroid_shift(radius) - bias).max() < 0.1 * np.abs(bias).max()


def test_a_map_of_third_order_is_expected_as_it_is() -> None:
    x, y = (GRID - 4.0).T
    pixel = np.stack([30 * x + 2 * y + 0.4 * x * y - 0.02 * x**3, 28 * y - x + 0.3 * x * x + 0.01 * x * y * y], -1)
    shape = lattice_shape(GRID, pixel)
    assert np.abs(shape.expected - pixel).max() < 1e-2
    cell = (30 + 0.4 * y - 0.06 * x * x) * (28 + 0.02 * x * y) - (2 + 0.4 * x) * (-1 + 0.6 * x + 0.01 * y * y)
    assert np.allclose(shape.cell_px2, cell, rtol=1e-3)


def test_the_doubt_is_what_noise_makes_of_the_expectation() -> None:
    rng = np.random.default_rng(1)
    pixel = 30.0 * GRID
    off = []
    for _ in range(200):
        noisy = pixel + rng.normal(0, 0.1, pixel.shape)
        off.append(noisy - lattice_shape(GRID, noisy).expected)
    seen = np.sqrt(np.mean(np.square(off), axis=(0, 2)))
    assert seen / 0.1 == pytest.approx(lattice_shape(GRID, np.asarray(pixel)).doubt, rel=0.25)
