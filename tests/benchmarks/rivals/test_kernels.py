"""Kernel ridge regression and the Gaussian process: smooth functions, noise, hyperparameters and a reference."""

import numpy as np
import pytest
from rival_samples import error_arcmin, grid_of_places, readings_of, samples_of
from scipy.optimize import check_grad, minimize

from benchmarks.rivals import kernels
from benchmarks.rivals.kernels import free_kernel_ridge, gaussian_process, kernel_ridge
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


@pytest.fixture
def likelihood(monkeypatch):
    """Calls of the optimiser: its cost, start and solution."""
    calls = []

    def watched(cost, start, **options):
        found = minimize(cost, start, **options)
        calls.append((cost, start, found.x))
        return found

    monkeypatch.setattr(kernels, "minimize", watched)
    return calls


def gaussians(first, second, lengths):
    """exp(-r^2 / 2), (n, m), of scaled inputs."""
    apart = (first[:, None] - second) / lengths
    return np.exp(-0.5 * np.sum(apart**2, axis=2))


@pytest.mark.parametrize(
    ("fit", "limit_arcmin"), [(kernel_ridge, 0.5), (free_kernel_ridge, 0.03), (gaussian_process, 0.015)]
)
def test_a_smooth_function_is_recovered(fit, limit_arcmin):
    assert error_arcmin(fit(samples_of(smooth, PLACES, 60)), smooth) < limit_arcmin


@pytest.mark.parametrize(
    ("fit", "limit_arcmin"), [(kernel_ridge, 0.5), (free_kernel_ridge, 0.5), (gaussian_process, 0.02)]
)
def test_two_blocks_are_told_apart_by_their_multipliers(fit, limit_arcmin):
    model = fit(samples_of(two_blocks, PLACES, 60, blocks=2))
    assert model.outputs == 4
    assert error_arcmin(model, two_blocks) < limit_arcmin


@pytest.mark.parametrize("fit", [kernel_ridge, free_kernel_ridge, gaussian_process])
def test_neither_noise_nor_stage_errors_are_followed(fit):
    """2,160 readings with noise of 1', from places that are 50 um beside the stated ones."""
    exact = samples_of(smooth, PLACES, 60)
    rng = np.random.default_rng(5)
    wrong = np.hstack([np.zeros((36, 2)), rng.normal(0.0, 5e-5, (36, 2))])[exact.position]
    inputs = exact.readings.inputs
    observed = smooth(inputs + wrong) + rng.normal(0.0, ARCMIN, (len(inputs), 2))
    model = fit(readings_of(inputs, exact.position, observed, exact.readings.multiplier, 1.0))
    assert error_arcmin(model, smooth) < 0.5


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


def test_the_published_form_is_held_back_by_its_ridge():
    """Its ridges begin at 1e-9: see the docstring of `free_kernel_ridge`."""
    samples = samples_of(smooth, PLACES, 60)
    assert error_arcmin(free_kernel_ridge(samples), smooth) < 0.2 * error_arcmin(kernel_ridge(samples), smooth)


def test_a_regressor_that_rounds_says_so():
    """Rounding of its values, as found by repeating it at neighbouring numbers, is at most what it states."""
    model = free_kernel_ridge(samples_of(smooth, PLACES, 60))
    inputs = np.full((200, 4), [0.4, 0.6, 0.001, 0.002])
    value = model(inputs + 1e-15 * np.arange(200)[:, None])
    assert np.ptp(value, axis=0).max() < 10.0 * model.rounding
    assert model.rounding < 1e-7


@pytest.mark.parametrize("blocks", [1, 2])
@pytest.mark.parametrize("noise_arcmin", [0.0, 1.0])
def test_gradient_of_the_likelihood_is_that_of_differences(likelihood, blocks, noise_arcmin):
    truth = smooth if blocks == 1 else two_blocks
    gaussian_process(samples_of(truth, PLACES, 4, blocks=blocks, noise=noise_arcmin))
    cost, start, _ = likelihood[0]
    at = start + np.random.default_rng(1).uniform(-0.3, 0.3, len(start))
    gradient = cost(at)[1]
    error = check_grad(lambda log: cost(log)[0], lambda log: cost(log)[1], at, epsilon=1e-5)
    assert error < 1e-3 * np.linalg.norm(gradient)


def test_lengths_size_and_noise_of_a_process_are_found(likelihood):
    rng = np.random.default_rng(11)
    inputs = rng.uniform(0.0, 1.0, (400, 2))
    lengths, size, stated, noise = np.array([0.3, 0.7]), 0.02, 0.5, 1.5
    covariance = size**2 * gaussians(2.0 * inputs, 2.0 * inputs, lengths) + (noise * ARCMIN) ** 2 * np.eye(400)
    observed = np.linalg.cholesky(covariance) @ rng.normal(size=(400, 2))
    gaussian_process(readings_of(inputs, np.arange(400) // 40, observed, np.ones((400, 1)), stated))
    found = np.exp(likelihood[0][2])
    np.testing.assert_allclose(found[:2] * 1.05, lengths, rtol=0.2)  # the box of the fit is 5 % wider
    assert found[2] == pytest.approx(size, rel=0.35)
    assert found[3] == pytest.approx(noise / stated, rel=0.15)


@pytest.mark.parametrize("blocks", [1, 2])
def test_with_all_readings_as_inducing_points_it_is_the_process_itself(likelihood, blocks):
    """Rasmussen and Williams, equation 2.25, after a trend."""
    samples = samples_of(smooth if blocks == 1 else two_blocks, PLACES[:20], 10, noise=1.0, blocks=blocks)
    model = gaussian_process(samples)
    lengths, (size, noise) = np.exp(likelihood[0][2][:4]), np.exp(likelihood[0][2][4:])
    trend = samples.polynomial(3)
    wanted = np.random.default_rng(3).uniform([0, 0, -SIZE, -SIZE], [1, 1, SIZE, SIZE], (50, 4))
    multiplier = samples.readings.multiplier
    rest = samples.target(trend) / samples.readings.weight[:, None]
    covariance = size**2 * (multiplier @ multiplier.T) * gaussians(samples.scaled, samples.scaled, lengths)
    seen = np.linalg.solve(covariance + np.diag((noise / samples.readings.weight) ** 2), rest)
    across = size**2 * gaussians(samples.readings.box.scaled(wanted), samples.scaled, lengths)
    expected = trend(wanted) + np.hstack([(across * multiplier[:, block]) @ seen for block in range(blocks)])
    np.testing.assert_allclose(model(wanted), expected, atol=1e-4 * ARCMIN)
