"""Kernel ridge regression and the Gaussian process: smooth functions."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from rival_samples import error_arcmin, grid_of_places, samples_of

from benchmarks.rivals.kernels import free_kernel_ridge, gaussian_process, kernel_ridge
from wlr_render.numerics.arrays import FloatArray

SIZE = 0.005
PLACES = grid_of_places(6, SIZE)


def smooth(inputs: FloatArray) -> FloatArray:
    """Tangents (n, 2): no polynomial and no sum of gaussians at the centres."""
    u, v, x, y = (inputs / [1.0, 1.0, SIZE, SIZE]).T
    first = 0.3 * np.sin(2.0 * u) + 0.02 * np.exp(-((u - 0.6) ** 2) / 0.3 - 0.3 * (v - 0.1 * x) ** 2)
    return np.column_stack([first + 0.003 * x * np.cos(v), 0.3 * v + 0.01 * np.sin(u + 0.3 * x * y)])


def two_blocks(inputs: FloatArray) -> FloatArray:
    """A and B, (n, 4)."""
    return np.hstack([smooth(inputs), 0.3 * smooth(inputs)[:, ::-1]])


@pytest.mark.parametrize(
    ("fit", "limit_arcmin"), [(kernel_ridge, 0.5), (free_kernel_ridge, 0.03), (gaussian_process, 0.015)]
)
def test_a_smooth_function_is_recovered(fit: Callable[..., Any], limit_arcmin: float) -> None:
    assert error_arcmin(fit(samples_of(smooth, PLACES, 60)), smooth) < limit_arcmin


@pytest.mark.parametrize(
    ("fit", "limit_arcmin"), [(kernel_ridge, 0.5), (free_kernel_ridge, 0.5), (gaussian_process, 0.02)]
)
def test_two_blocks_are_told_apart_by_their_multipliers(fit: Callable[..., Any], limit_arcmin: float) -> None:
    model = fit(samples_of(two_blocks, PLACES, 40, blocks=2))
    assert model.outputs == 4
    assert error_arcmin(model, two_blocks) < limit_arcmin
