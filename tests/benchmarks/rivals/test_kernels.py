"""Kernel ridge regression and the Gaussian process: smooth functions, noise, hyperparameters and a reference."""

import numpy as np
import pytest
from rival_samples import error_arcmin, grid_of_places, samples_of

from benchmarks.rivals import kernels
from benchmarks.rivals.kernels import free_kernel_ridge, gaussian_process, kernel_ridge
from benchmarks.rivals.weighted_kernel import WeightedKernel
from wlr_render.geometry.directions import ARCMIN

SIZE = 0.005
PLACES = grid_of_places(6, SIZE)


def smooth(inputs):
    """Tangents (n, 2): no polynomial and no sum of gaussians at the centres."""
    u, v, x, y = (inputs / [1.0, 1.0, SIZE, SIZE]).T
    first = 0.3 * np.sin(2.0 * u) + 0.02 * np.exp(-((u - 0.6) ** 2) / 0.3 - 0.3 * (v - 0.1 * x) ** 2)
    return np.column_stack([first + 0.003 * x * np.cos(v), 0.3 * v + 0.01 * np.sin(u + 0.3 * x * y)])


def two_blocks(inputs):
    """A and B, (n, 4)."""
    return np.hstack([smooth(inputs), 0.3 * smooth(inputs)[:, ::-1]])


@pytest.mark.parametrize(
    ("fit", "limit_arcmin"), [(kernel_ridge, 0.5), (free_kernel_ridge, 0.03), (gaussian_process, 0.015)]
)
def test_a_smooth_function_is_recovered(fit, limit_arcmin):
    assert error_arcmin(fit(samples_of(smooth, PLACES, 60)), smooth) < limit_arcmin


@pytest.mark.parametrize(
    ("fit", "limit_arcmin"), [(kernel_ridge, 0.5), (free_kernel_ridge, 0.5), (gaussian_process, 0.02)]
)
def test_two_blocks_are_told_apart_by_their_multipliers(fit, limit_arcmin):
    model = fit(samples_of(two_blocks, PLACES, 40, blocks=2))
    assert model.outputs == 4
    assert error_arcmin(model, two_blocks) < limit_arcmin


@pytest.mark.parametrize(("noise_arcmin", "chosen"), [(0.0, 0), (30.0, 1)])
def test_held_out_positions_choose_a_larger_ridge_for_noisier_readings(monkeypatch, noise_arcmin, chosen):
    ridges = np.array([1e-6, 1.0])
    samples = samples_of(smooth, PLACES, 40, noise=noise_arcmin)
    inputs = samples.readings.inputs[:50]
    monkeypatch.setattr(kernels, "_WIDTHS", (1.0,))
    values = []
    for offered in (ridges, ridges[:1], ridges[1:]):
        monkeypatch.setattr(kernels, "_SMALL_RIDGES", offered)
        values.append(free_kernel_ridge(samples)(inputs))
    either, *alone = values
    np.testing.assert_array_equal(either, alone[chosen])
    assert np.abs(either - alone[1 - chosen]).max() > 0.01 * ARCMIN


def test_a_regressor_that_rounds_says_so():
    """Rounding of its values, as found by repeating it at neighbouring numbers, is at most what it states."""
    model = free_kernel_ridge(samples_of(smooth, PLACES, 40))
    inputs = np.full((200, 4), [0.4, 0.6, 0.001, 0.002])
    value = model(inputs + 1e-15 * np.arange(200)[:, None])
    assert np.ptp(value, axis=0).max() < 10.0 * model.rounding
    assert model.rounding < 1e-7


def test_the_covariance_of_weighted_readings_has_the_gradient_of_its_logarithms():
    rng = np.random.default_rng(1)
    rows = np.hstack([rng.uniform(-1.0, 1.0, (6, 3)), rng.normal(size=(6, 2))])
    lengths = np.array([0.3, 0.7, 1.1])
    kernel = WeightedKernel(lengths, blocks=2)
    gaussians = np.exp(-0.5 * np.sum(((rows[:, None, :3] - rows[:, :3]) / lengths) ** 2, axis=2))
    value, gradient = kernel(rows, eval_gradient=True)
    np.testing.assert_allclose(value, (rows[:, 3:] @ rows[:, 3:].T) * gaussians, atol=1e-14)
    np.testing.assert_allclose(kernel.diag(rows), np.diag(value))
    np.testing.assert_allclose(kernel(rows[:2], rows), value[:2])
    for axis in range(3):
        step = 1e-6 * np.eye(3)[axis]
        changed = [kernel.clone_with_theta(kernel.theta + sign * step)(rows) for sign in (1.0, -1.0)]
        np.testing.assert_allclose(gradient[..., axis], (changed[0] - changed[1]) / 2e-6, atol=1e-8)
