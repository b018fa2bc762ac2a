"""Small networks: gradient, injected truth, stage errors and noise that they must not follow, budget."""

import itertools
import time

import numpy as np
import pytest
from rival_samples import readings_of
from scipy.optimize import check_grad, rosen, rosen_der

from benchmarks.rivals import network_training
from benchmarks.rivals.network_training import ProjectedLoss, TanhLayers, TimedSearch
from benchmarks.rivals.networks import network
from benchmarks.rivals.samples import Samples
from wlr_render.geometry.directions import ARCMIN
from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.regressor import Regressor

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
    x, y = (inputs[:, 2:4] / 0.005).T if inputs.shape[1] > 2 else np.zeros((2, len(u)))
    bump = 0.01 * np.exp(-((u - 0.6) ** 2) / 0.2 - (v - 0.2 + 0.1 * x) ** 2 / 0.3)
    return np.column_stack([0.6 * u - 0.3 + bump + 2e-3 * x * np.sin(2 * u), 0.5 * v - 0.2 + bump * y - 1e-3 * x * y])


def samples(variables: int = 4, noise: float = 0.0, stage_m: float = 0.0) -> Samples:
    """Readings of `truth` from a grid of places whose true place is off by a stage error, with noise in arcminutes."""
    rng = np.random.default_rng(1)
    steps = np.linspace(-0.005, 0.005, 5)
    place = np.column_stack([np.stack(np.meshgrid(steps, steps), -1).reshape(-1, 2), rng.uniform(-0.003, 0.003, 25)])
    position = np.repeat(np.arange(PLACES, dtype=np.int64), READINGS)
    inputs = np.hstack([rng.uniform(0.0, 1.0, (len(position), 2)), place[position]])[:, :variables]
    moved = (
        inputs + (np.hstack([np.zeros((PLACES, 2)), rng.normal(0.0, stage_m, (PLACES, 3))])[position])[:, :variables]
    )
    observed = truth(moved) + rng.normal(0.0, noise * ARCMIN, (len(inputs), 2))
    return readings_of(inputs, position, observed, np.ones((len(inputs), 1)), noise)


def error_arcmin(model: Regressor, variables: int = 4) -> float:
    """Rms error per axis at pixels and places that were not read."""
    rng = np.random.default_rng(2)
    place = rng.uniform(-0.0045, 0.0045, (500, 3)) * [1.0, 1.0, 0.6]
    inputs = np.hstack([rng.uniform(0.05, 0.95, (500, 2)), place])[:, :variables]
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


def long_valley(weights: FloatArray) -> tuple[float, FloatArray]:
    """A loss (Rosenbrock's) that takes hundreds of steps, and its gradient."""
    return float(rosen(weights)), np.asarray(rosen_der(weights))


def test_search_ends_with_its_budget(monkeypatch: pytest.MonkeyPatch) -> None:
    """A clock that goes on by a second with each evaluation."""
    clock = [0.0]
    monkeypatch.setattr(time, "process_time", lambda: clock[0])

    def loss(weights: FloatArray) -> tuple[float, FloatArray]:
        clock[0] += 1.0
        return long_valley(weights)

    search = TimedSearch(deadline=12.0, best=np.full(20, -1.0))
    search.run(loss, lambda weights: long_valley(weights)[0])
    assert 8 <= clock[0] <= 20  # one line search at most past the end


def test_search_keeps_the_best_and_stops_when_checks_stay_behind(monkeypatch: pytest.MonkeyPatch) -> None:
    """The error that decides is least on the way to where the loss is least."""
    monkeypatch.setattr(network_training, "_CHECK_EVERY", 1)
    evaluations = 0

    def loss(weights: FloatArray) -> tuple[float, FloatArray]:
        nonlocal evaluations
        evaluations += 1
        return long_valley(weights)

    search = TimedSearch(deadline=np.inf, best=np.full(20, -1.0))
    search.run(loss, lambda weights: float(abs(weights[0])))
    assert search.error == abs(search.best[0]) < 0.9
    stopped, evaluations = evaluations, 0
    to_the_end = TimedSearch(deadline=np.inf, best=np.full(20, -1.0))
    to_the_end.run(loss, lambda weights: long_valley(weights)[0])
    assert to_the_end.error < 1e-9
    assert stopped < 0.6 * evaluations


def test_same_weights_for_the_same_readings_and_numbers_count_them() -> None:
    layers = TanhLayers((4, 32, 32))
    assert layers.numbers == 5 * 32 + 33 * 32
    first, second = (layers.start(np.random.default_rng(0), np.ones(4)) for _ in range(2))
    np.testing.assert_array_equal(first, second)
    model = network(samples(), seconds=0.1)
    assert model.numbers == layers.numbers + (32 + 35) * 2
