"""Samples of functions in closed form, for regressors."""

from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks.rivals.numeric_regressor import NumericRegressor
from benchmarks.rivals.samples import Samples
from wlr_render.calibration.readings import FitReadings
from wlr_render.geometry.directions import ARCMIN
from wlr_render.numerics.arrays import FloatArray, IntArray


def readings_of(
    inputs: FloatArray, position: IntArray, observed: FloatArray, multiplier: FloatArray, sigma: float = 0.0
) -> Samples:
    """Samples whose first two inputs are the pixel."""
    readings = FitReadings(
        inputs=inputs,
        is_place=np.arange(inputs.shape[1]) >= 2,
        observed=observed,
        multiplier=multiplier,
        metric=np.full(len(inputs), 1.0 / ARCMIN),
        sigma=np.full(len(inputs), sigma),
        capture=position,
        motion=None,
        orders=np.zeros((0, inputs.shape[1]), np.int64),
    )
    return Samples(readings, position)


def samples_of(
    function: Callable[..., Any],
    place: FloatArray,
    readings: int = 150,
    noise: float = 0.0,
    blocks: int = 1,
    seed: int = 1,
) -> Samples:
    """Samples of a function of (u, v, place) at k places (k, variables), pixels in 0..1; noise in arcminutes.

    `function` gives 2 outputs for each block; a second one is seen through one of two inverse depths.
    """
    rng = np.random.default_rng(seed)
    position = np.repeat(np.arange(len(place)), readings)
    inputs = np.hstack([rng.uniform(0.0, 1.0, (len(position), 2)), place[position]])
    multiplier = np.ones((len(position), blocks))
    if blocks == 2:
        multiplier[:, 1] = rng.choice([0.33, 2.5], len(position))
    observed = np.einsum("nb,nbo->no", multiplier, function(inputs).reshape(len(inputs), blocks, 2))
    noisy = observed + rng.normal(0.0, noise * ARCMIN, observed.shape)
    return readings_of(inputs, position, noisy, multiplier, noise)


def grid_of_places(count: int = 5, size: float = 0.005) -> FloatArray:
    """Places (count * count, 2) within +-size metres."""
    steps = np.linspace(-size, size, count)
    return np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)


def error_arcmin(
    model: NumericRegressor, function: Callable[..., Any], variables: int = 4, size: float = 0.005
) -> float:
    """Rms error per axis over all outputs at pixels and places that were not read."""
    rng = np.random.default_rng(2)
    place = rng.uniform(-size, size, (500, variables - 2))
    inputs = np.hstack([rng.uniform(0.0, 1.0, (500, 2)), place])
    return float(np.sqrt(np.mean((model(inputs) - function(inputs)) ** 2)) / ARCMIN)
