"""Small networks: gradient, and injected truth."""

import itertools
import time

import numpy as np
import pytest
from rival_samples import readings_of
from scipy.optimize import check_grad

from benchmarks.rivals.network_training import ProjectedLoss, TanhLayers
from benchmarks.rivals.networks import network
from benchmarks.rivals.numeric_regressor import Regressor
from benchmarks.rivals.samples import Samples
from wlr_render.geometry.directions import ARCMIN
from wlr_render.numerics.arrays import FloatArray

PLACES = 25
READINGS = 150
"""Of each place."""


@pytest.fixture(autouse=True)
def _clock_of_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """A budget of one second is a hundred looks at the clock, on machines of any speed."""
    ticks = itertools.count()
    monkeypatch.setattr(time, "process_time", lambda: 0.01 * next(ticks))


def truth(inputs: FloatArray) -> FloatArray:
    """Tangents (n, 2) of pixels in 0..1 and places in metres, within 5 mm: no polynomial, and no sum of tanh."""
    u, v = inputs[:, 0], inputs[:, 1]
    x, y = (inputs[:, 2:4] / 0.005).T
    bump = 0.01 * np.exp(-((u - 0.6) ** 2) / 0.2 - (v - 0.2 + 0.1 * x) ** 2 / 0.3)
    return np.column_stack([0.6 * u - 0.3 + bump + 2e-3 * x * np.sin(2 * u), 0.5 * v - 0.2 + bump * y - 1e-3 * x * y])


def samples() -> Samples:
    """Exact readings of `truth` from a grid of places."""
    rng = np.random.default_rng(1)
    steps = np.linspace(-0.005, 0.005, 5)
    place = np.column_stack([np.stack(np.meshgrid(steps, steps), -1).reshape(-1, 2), rng.uniform(-0.003, 0.003, 25)])
    position = np.repeat(np.arange(PLACES, dtype=np.int64), READINGS)
    inputs = np.hstack([rng.uniform(0.0, 1.0, (len(position), 2)), place[position]])[:, :4]
    return readings_of(inputs, position, truth(inputs), np.ones((len(inputs), 1)))


def error_arcmin(model: Regressor) -> float:
    """Rms error per axis at pixels and places that were not read."""
    rng = np.random.default_rng(2)
    place = rng.uniform(-0.0045, 0.0045, (500, 3)) * [1.0, 1.0, 0.6]
    inputs = np.hstack([rng.uniform(0.05, 0.95, (500, 2)), place])[:, :4]
    return float(np.sqrt(np.mean((model(inputs) - truth(inputs)) ** 2)) / ARCMIN)


def test_gradient_of_the_projected_loss_is_that_of_differences() -> None:
    rng = np.random.default_rng(0)
    layers = TanhLayers((3, 5, 4))
    trend = np.ones((40, 1))
    loss = ProjectedLoss(
        layers, rng.uniform(-1, 1, (40, 3)), trend, rng.normal(size=(40, 2)), rng.normal(size=(40, 2)), decay=0.1
    )
    weights = layers.start(rng, np.ones(3))
    _, gradient = loss(weights)
    off = check_grad(lambda w: loss(w)[0], lambda w: loss(w)[1], weights, epsilon=1e-6)
    assert off < 1e-4 * np.linalg.norm(gradient)


def test_a_smooth_function_is_recovered() -> None:
    """The trend of degree 3 alone leaves 1.2'."""
    assert error_arcmin(network(samples(), seconds=1.0)) < 0.3
