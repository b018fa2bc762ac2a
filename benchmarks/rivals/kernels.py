"""Sums of Gaussians about centres: kernel ridge regression, and the Gaussian process.

Kernel ridge regression is Itoh and Klinker's light-field correction ("Light-field correction for spatial calibration of
optical see-through head-mounted displays", IEEE TVCG 21(4), 2015) in the form of their published code: 200 random
readings as centres, Gaussians of one width, ridge and width by fivefold cross-validation. It differs from that code:
folds are of camera positions, not of readings; the widths 0.1 and 0.2 are left out; and width and ridge are chosen
jointly for both outputs.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import minimize

from benchmarks.rivals.samples import Samples
from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.polynomial import Polynomial
from wlr_render.numerics.regressor import NumericRegressor

_WIDTHS = (0.5, 0.67, 1.0, 1.5, 2.0, 5.0, 10.0)  # of a Gaussian, in median distances between readings and centres
_RIDGES = np.logspace(-9, -1, 6)  # as in the published code
_SMALL_RIDGES = np.logspace(-13, -3, 6)
_TUNED = 4_000  # readings by which width and ridge are chosen
_TUNING_CENTRES = 200
_LIKELY = 400  # readings whose likelihood gives the hyperparameters of the Gaussian process
_JITTER = 1e-9
_RIDGE_ROUNDING = 1e-14


def kernel_ridge(samples: Samples) -> NumericRegressor:
    """Fit kernel ridge regression as published: 200 centres, no trend but the mean, ridges of 1e-9 and more."""
    return _ridge(samples, centres=200, ridges=_RIDGES, trend=samples.polynomial(0))


def free_kernel_ridge(samples: Samples) -> NumericRegressor:
    """Fit kernel ridge regression with 1,000 centres (see-through 300), a trend, and ridges down to 1e-13."""
    return _ridge(samples, 1_000 if samples.readings.blocks == 1 else 300, _SMALL_RIDGES, _trend(samples))


def _trend(samples: Samples) -> Polynomial:
    """Polynomial of degree 3, or less where there are too few camera positions."""
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
        # A ridge is relative to standardised outputs, as published, and readings of weight one.
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
    """Fit weights of features to what a trend leaves, with least squares of the rest and of prior @ weights.

    Args:
        samples: what to fit.
        features: inputs (n, variables) -> (n, k).
        prior: (m, columns), with the columns of `Samples.design`.
        trend: subtracted from the observed values first.
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
    """Gaussians (n, k) of points (n, d) about centres (k, d)."""
    return np.asarray(np.exp(-_squares(points, centres) / (2.0 * width**2)))


def _squares(points: FloatArray, centres: FloatArray) -> FloatArray:
    """Squared distances (n, k) of points (n, d) from centres (k, d)."""
    square = np.sum(points**2, axis=1)[:, None] + np.sum(centres**2, axis=1) - 2.0 * points @ centres.T
    return np.asarray(np.maximum(square, 0.0))


@dataclass(frozen=True)
class _Process:
    """Hyperparameters of a Gaussian process of unit noise.

    Attributes:
        lengths: (variables,) of the Gaussian, in inputs scaled to -1..1.
        size: standard deviation of the function.
        noise: factor on the stated sigma.
    """

    lengths: FloatArray
    size: float
    noise: float


def gaussian_process(samples: Samples) -> NumericRegressor:
    """Fit a Gaussian process with a length for each input, on a polynomial trend.

    The hyperparameters maximise the likelihood of 400 readings. All readings then give the weights of inducing points
    (subset of regressors: Rasmussen and Williams, "Gaussian Processes for Machine Learning", section 8.3.1).
    """
    trend = _trend(samples)
    process = _most_likely(samples, trend)
    rng = np.random.default_rng(2)
    inducing = samples.scaled[rng.permutation(len(samples))[: 600 // samples.readings.blocks]] / process.lengths
    root = np.asarray(cholesky(_gaussians(inducing, inducing) + _JITTER * np.eye(len(inducing))))
    prior = np.kron(np.eye(samples.readings.blocks), root) * (process.noise / process.size)
    box = samples.readings.box

    def features(inputs: FloatArray) -> FloatArray:
        return _gaussians(box.scaled(inputs) / process.lengths, inducing)

    return _solved(samples, features, prior, trend, inducing.size)


def _most_likely(samples: Samples, trend: Polynomial) -> _Process:
    rng = np.random.default_rng(3)
    rows = rng.permutation(len(samples))[:_LIKELY]
    inputs, target = samples.scaled[rows], samples.target(trend, rows)
    weight, multiplier = samples.readings.weight[rows], samples.readings.multiplier[rows]
    gain = (multiplier * weight[:, None]) @ (multiplier * weight[:, None]).T
    size = float(np.sqrt(np.mean(target**2))) or 1.0
    variables = inputs.shape[1]
    apart = [np.subtract.outer(inputs[:, axis], inputs[:, axis]) ** 2 for axis in range(variables)]

    def cost(log: FloatArray) -> tuple[float, FloatArray]:
        """Minus the log likelihood and its gradient by the logarithms of lengths, size and noise."""
        lengths, amplitude, noise = np.exp(log[:variables]), np.exp(log[-2]), np.exp(log[-1])
        correlation = np.exp(-0.5 * sum(each / length**2 for each, length in zip(apart, lengths, strict=True)))
        function = amplitude**2 * gain * correlation
        covariance = function + (noise**2 + 1e-10 * amplitude**2 * gain.max()) * np.eye(len(rows))
        try:
            root = cholesky(covariance, lower=True)
        except np.linalg.LinAlgError:
            return 1e12, np.zeros(len(log))
        inverse = solve_triangular(root, np.eye(len(rows)), lower=True)
        inverse = inverse.T @ inverse
        seen = inverse @ target
        value = 2.0 * float(np.sum(np.log(np.diag(root)))) + 0.5 * float(np.sum(target * seen))
        slope = inverse - 0.5 * (seen @ seen.T)  # by the covariance: both axes share it
        by_lengths = [np.sum(slope * function * each) / length**2 for each, length in zip(apart, lengths, strict=True)]
        gradient = [*by_lengths, 2.0 * np.sum(slope * function), 2.0 * noise**2 * np.trace(slope)]
        return value, np.array(gradient)

    stated = 0.0 if np.any(samples.readings.sigma > 0) else np.log(1e-3 * size)
    start = np.concatenate([np.zeros(variables), [np.log(size / np.sqrt(gain.diagonal().mean())), stated]])
    bounds = [(-2.0, 4.0)] * variables + [(start[-2] - 8.0, start[-2] + 8.0), (start[-1] - 14.0, start[-1] + 2.0)]
    found = minimize(cost, start, jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": 60}).x
    return _Process(np.exp(found[:variables]), float(np.exp(found[-2])), float(np.exp(found[-1])))
