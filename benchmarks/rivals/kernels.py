"""Sums of Gaussians about centres: kernel ridge regression, and the Gaussian process.

Kernel ridge regression is Itoh and Klinker's light-field correction ("Light-field correction for spatial calibration of
optical see-through head-mounted displays", IEEE TVCG 21(4), 2015) in the form of their published code: 200 random
readings as centres, Gaussians of one width, ridge and width by fivefold cross-validation. It differs from that code:
folds are camera positions, not readings; the widths 0.1 and 0.2 are left out; and width and ridge are chosen jointly
for both outputs.
"""

import warnings
from collections.abc import Callable, Iterable

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from benchmarks.rivals.numeric_regressor import NumericRegressor
from benchmarks.rivals.samples import Samples
from wlr_render.extras import installed_by
from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.polynomial import Polynomial

_WIDTHS = (0.5, 0.67, 1.0, 1.5, 2.0, 5.0, 10.0)  # widths of a Gaussian over the median distance of readings and centres
_RIDGES = np.logspace(-9, -1, 6)  # ridges of the published code
_SMALL_RIDGES = np.logspace(-13, -3, 6)
_TUNED = 4_000  # number of readings for the choice of width and ridge
_TUNING_CENTRES = 200
_LIKELY = 400  # number of readings in the likelihood for the hyperparameters of the Gaussian process
_START_LENGTH = 3.0  # start of the likelihood search; shorter lengths may end with the function treated as noise
_JITTER = 1e-9
_RIDGE_ROUNDING = 1e-14


def kernel_ridge(samples: Samples) -> NumericRegressor:
    """Fit kernel ridge regression as published: 200 centres, the mean as the only trend, ridges from 1e-9."""
    return _ridge(samples, centres=200, ridges=_RIDGES, trend=samples.polynomial(0))


def free_kernel_ridge(samples: Samples) -> NumericRegressor:
    """Fit kernel ridge regression with 1,000 centres (see-through 300), a trend, and ridges down to 1e-13."""
    return _ridge(samples, 1_000 if samples.readings.blocks == 1 else 300, _SMALL_RIDGES, _trend(samples))


def _trend(samples: Samples) -> Polynomial:
    """Fit a polynomial of degree 3, or less if there are too few camera positions."""
    positions = int(samples.position.max()) + 1
    return samples.polynomial(3 if positions >= 20 or not samples.is_place.any() else 2 if positions >= 10 else 1)


def _ridge(samples: Samples, centres: int, ridges: FloatArray, trend: Polynomial) -> NumericRegressor:
    rng = np.random.default_rng(1)
    mean, spread = samples.readings.inputs.mean(axis=0), samples.readings.inputs.std(axis=0)
    spread[spread == 0.0] = 1.0
    inputs = (samples.readings.inputs - mean) / spread
    chosen = inputs[rng.permutation(len(samples))[:centres]]
    few = rng.permutation(len(samples))[:_TUNED]
    target = samples.target(trend)
    size = float(np.sqrt(np.mean(target**2))) or 1.0
    unit = float(np.sqrt(np.median(_squares(inputs[few[:500]], chosen))))
    tuning = chosen[: _TUNING_CENTRES // samples.readings.blocks]

    def solutions(design: FloatArray, target: FloatArray) -> Iterable[FloatArray]:
        left, each, axes = np.linalg.svd(design, full_matrices=False)
        return (axes.T @ ((each / (each**2 + ridge))[:, None] * (left.T @ target)) for ridge in ridges)

    best = (np.inf, _WIDTHS[0], float(ridges[0]))
    for width in _WIDTHS:
        # The ridge refers to standardised outputs, as published, and to readings of weight one.
        features = _gaussians(inputs[few], tuning, unit * width) / size
        error = samples.held_out_errors(features, target[few] / size, solutions, few)
        best = min(best, (float(error.min()), width, float(ridges[int(np.argmin(error))])))
    scale, ridge = unit * best[1], best[2]
    prior = size * np.sqrt(ridge) * np.eye(len(chosen) * samples.readings.blocks)
    return _solved(
        samples, lambda inputs: _gaussians((inputs - mean) / spread, chosen, scale), prior, trend, chosen.size
    )


def _solved(
    samples: Samples, features: Callable[[FloatArray], FloatArray], prior: FloatArray, trend: Polynomial, centres: int
) -> NumericRegressor:
    """Fit weights of features to the residual of a trend, with a quadratic penalty on prior @ weights.

    Args:
        samples: samples to fit.
        features: function of inputs (n, variables) that returns features (n, k).
        prior: (m, columns), with the columns of `Samples.design`.
        trend: polynomial that is subtracted from the observed values first.
        centres: number of values that the features store.
    """
    design = samples.design(features(samples.readings.inputs))
    orthogonal, triangle = np.linalg.qr(np.vstack([design, prior]))
    values = np.vstack([samples.target(trend), np.zeros((len(prior), 2))])
    weights = samples.by_block(np.asarray(solve_triangular(triangle, orthogonal.T @ values)))
    rounding = max(1e-12, _RIDGE_ROUNDING * float(np.abs(weights).max()))
    return NumericRegressor(
        lambda inputs: trend(inputs) + features(inputs) @ weights,
        samples.readings.box,
        samples.outputs,
        centres + weights.size + trend.numbers,
        rounding,
    )


def _gaussians(points: FloatArray, centres: FloatArray, width: float = 1.0) -> FloatArray:
    """Return Gaussians (n, k) of points (n, d) about centres (k, d)."""
    return np.asarray(np.exp(-_squares(points, centres) / (2.0 * width**2)))


def _squares(points: FloatArray, centres: FloatArray) -> FloatArray:
    """Return squared distances (n, k) of points (n, d) from centres (k, d)."""
    square = np.sum(points**2, axis=1)[:, None] + np.sum(centres**2, axis=1) - 2.0 * points @ centres.T
    return np.asarray(np.maximum(square, 0.0))


def gaussian_process(samples: Samples) -> NumericRegressor:
    """Fit a Gaussian process with a length scale for each input, on a polynomial trend.

    The hyperparameters maximise the likelihood of 400 readings. All readings then give the weights of inducing points
    (subset of regressors: Rasmussen and Williams, "Gaussian Processes for Machine Learning", section 8.3.1).

    Raises:
        MissingExtraError: scikit-learn is not installed.
    """
    trend = _trend(samples)
    lengths, noise_by_size = _most_likely(samples, trend)
    rng = np.random.default_rng(2)
    inducing = samples.scaled[rng.permutation(len(samples))[: 600 // samples.readings.blocks]] / lengths
    root = np.asarray(cholesky(_gaussians(inducing, inducing) + _JITTER * np.eye(len(inducing))))
    prior = np.kron(np.eye(samples.readings.blocks), root) * noise_by_size
    box = samples.readings.box

    def features(inputs: FloatArray) -> FloatArray:
        return _gaussians(box.scaled(inputs) / lengths, inducing)

    return _solved(samples, features, prior, trend, inducing.size)


def _most_likely(samples: Samples, trend: Polynomial) -> tuple[FloatArray, float]:
    """Return the length scales (variables,) of a process in scaled inputs, and its noise over the size of the function.

    The noise refers to weighted readings: it is a factor on the stated sigma.
    """
    with installed_by("bench", "gaussian_process"):
        from sklearn.exceptions import ConvergenceWarning
        from sklearn.gaussian_process import GaussianProcessRegressor
        from sklearn.gaussian_process.kernels import ConstantKernel, WhiteKernel

        from benchmarks.rivals.weighted_kernel import WeightedKernel

    rows = np.random.default_rng(3).permutation(len(samples))[:_LIKELY]
    target, weight = samples.target(trend, rows), samples.readings.weight[rows]
    multiplier = samples.readings.multiplier[rows] * weight[:, None]
    gain = np.sum(multiplier**2, axis=1)
    size = (float(np.mean(target**2)) or 1.0) / float(np.mean(gain))
    noise = 1.0 if np.any(samples.readings.sigma > 0) else 1e-6 * size * float(np.mean(gain))
    lengths = np.full(samples.scaled.shape[1], _START_LENGTH)
    kernel = ConstantKernel(size, (np.exp(-16.0) * size, np.exp(16.0) * size)) * WeightedKernel(
        lengths, (np.exp(-2.0), np.exp(4.0)), blocks=multiplier.shape[1]
    ) + WhiteKernel(noise, (np.exp(-28.0) * noise, np.exp(4.0) * noise))
    process = GaussianProcessRegressor(kernel, alpha=1e-10 * size * float(gain.max()))
    with warnings.catch_warnings(action="ignore", category=ConvergenceWarning):  # a length scale at its bound
        found = process.fit(np.hstack([samples.scaled[rows], multiplier]), target).kernel_
    return found.k1.k2.length_scale, float(np.sqrt(found.k2.noise_level / found.k1.k1.constant_value))
