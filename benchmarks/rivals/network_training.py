"""Training of small networks of tanh units by variable projection and L-BFGS.

Variable projection: the last, linear layer is the least-squares solution for given hidden weights, so that only the
hidden weights are searched. There the loss does not change with the last layer to first order; therefore its gradient
by the hidden weights is the partial derivative (Golub and Pereyra, Inverse Problems 19(2) R1, 2003). The search is
`scipy.optimize.minimize` with L-BFGS-B. It stops when held-out camera positions are no longer predicted better, or when
the process time is spent. Therefore the results depend on the speed of the machine.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Protocol

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize

from benchmarks.rivals.numeric_regressor import NumericRegressor
from benchmarks.rivals.samples import Samples
from wlr_render.numerics.arrays import FloatArray, IntArray
from wlr_render.numerics.polynomial import Polynomial, basis, total_degree

_ROUNDING = 1e-10  # rounding of values: units of the last layer cancel, and its weights reach 100 times the values
_RIDGE = 1e-9  # ridge on the last layer, relative to the mean square of its multipliers
_TREND_RIDGE = 1e-13  # ridge that keeps terms small that the readings do not determine
_FIRST_ROWS = 3_000
_MORE_ROWS = 4  # factor by which the readings grow after each search that ends before the deadline
_PLACE_SIZES = (0.1, 0.1, 0.3)  # tried sizes of the place's first weights over the pixel's: maps vary slowly with place
_TRIAL = 0.12  # share of the process time for each size; the best size at held-out positions is continued
_CHECK_EVERY, _PATIENCE = 8, 5  # iterations between checks; number of checks without improvement before the end


class Layers(Protocol):
    """Hidden layers with weights in one flat array: `TanhLayers`, or `distortion_field.RayLayers`."""

    @property
    def sizes(self) -> tuple[int, ...]:
        """Number of inputs, then of units of each layer; the linear layer takes the last layer's values."""

    def start(self, rng: np.random.Generator, size: FloatArray) -> FloatArray:
        """Draw random weights; `size` (variables,) multiplies the weights of each input."""

    def values(self, weights: FloatArray, inputs: FloatArray) -> list[FloatArray]:
        """Return all layers' values for inputs (n, variables), the last being (n, sizes[-1]); `gradient` needs all."""

    def gradient(self, weights: FloatArray, values: list[FloatArray], by_last: FloatArray) -> FloatArray:
        """Return a loss's derivative (weights,) by the weights, from its derivative by last values (n, sizes[-1])."""


@dataclass(frozen=True)
class TanhLayers:
    """Fully connected layers of tanh units with weights in one flat array.

    Attributes:
        sizes: numbers of inputs and of the units of each layer.
    """

    sizes: tuple[int, ...]

    @property
    def numbers(self) -> int:
        """Number of weights and biases."""
        return sum((before + 1) * after for before, after in pairwise(self.sizes))

    def start(self, rng: np.random.Generator, size: FloatArray) -> FloatArray:
        """Draw random weights (numbers,) for inputs within -1..1; `size` (sizes[0],) holds a factor for each input."""
        parts = []
        for before, after in pairwise(self.sizes):
            parts += [rng.normal(0.0, before**-0.5, (before, after)), rng.uniform(-1.0, 1.0, after)]
        parts[0] *= size[:, None]
        return np.concatenate([np.ravel(part) for part in parts])

    def values(self, weights: FloatArray, inputs: FloatArray) -> list[FloatArray]:
        """Return the inputs (n, sizes[0]), then the values (n, size) of each layer."""
        found = [inputs]
        for matrix, bias in self._parts(weights):
            found.append(np.tanh(found[-1] @ matrix + bias))
        return found

    def gradient(self, weights: FloatArray, values: list[FloatArray], by_last: FloatArray) -> FloatArray:
        """Return the derivative (numbers,) of a loss by the weights.

        Args:
            weights: (numbers,) weights.
            values: result of `values`.
            by_last: (n, sizes[-1]) derivative of the loss by the last layer's values.
        """
        found: list[FloatArray] = []
        by = by_last
        for (matrix, _), (before, after) in reversed(list(zip(self._parts(weights), pairwise(values), strict=True))):
            by = by * (1.0 - after * after)
            found = [np.ravel(before.T @ by), by.sum(axis=0), *found]
            by = by @ matrix.T
        return np.concatenate(found)

    def _parts(self, weights: FloatArray) -> list[tuple[FloatArray, FloatArray]]:
        parts, at = [], 0
        for before, after in pairwise(self.sizes):
            middle, end = at + before * after, at + (before + 1) * after
            parts.append((weights[at:middle].reshape(before, after), weights[middle:end]))
            at = end
        return parts


@dataclass(frozen=True, eq=False)
class ProjectedLoss:
    """Mean square residual of a target as a function of hidden weights, given a trend and the best last layer.

    target = sum over blocks b of multiplier_b ([hidden units, trend] @ coefficients_b).

    Attributes:
        layers: hidden layers.
        inputs: (n, variables), -1..1. trend: (n, terms).
        multiplier: (n, blocks), including the weights of the rows.
        target: (n, outputs), weighted.
        decay: factor of the mean square of the hidden weights in the loss.
    """

    layers: Layers
    inputs: FloatArray
    trend: FloatArray
    multiplier: FloatArray
    target: FloatArray
    decay: float = 0.0

    @classmethod
    def of(
        cls, samples: Samples, rows: IntArray, layers: Layers, degree: int, known: Polynomial | None
    ) -> "ProjectedLoss":
        """Return the loss of some rows of samples.

        Args:
            samples: samples to fit.
            rows: (n,) rows of the samples.
            layers: hidden layers.
            degree: degree of the polynomial trend.
            known: polynomial that is subtracted from the observed values first.
        """
        readings = samples.readings
        trend = basis(readings.inputs[rows], total_degree(len(samples.is_place), degree), readings.box)
        multiplier = readings.multiplier[rows] * readings.weight[rows, None]
        return cls(layers, samples.scaled[rows], trend, multiplier, samples.target(known, rows))

    def __call__(self, weights: FloatArray) -> tuple[float, FloatArray]:
        """Return the loss, and its gradient by the hidden weights (numbers,)."""
        values = self.layers.values(weights, self.inputs)
        design = self.design(values[-1])
        solution = self.solve(design)
        rest = design @ solution - self.target
        blocks = solution.reshape(self.multiplier.shape[1], -1, solution.shape[1])
        loss = np.sum(rest**2) / len(rest) + self._penalty() @ np.sum(solution**2, axis=1)
        of_units = blocks[:, : values[-1].shape[1]]
        by_last = np.zeros_like(values[-1])
        for multiplier, coefficients in zip(self.multiplier.T, of_units, strict=True):
            by_last += (rest * (2.0 / len(rest) * multiplier)[:, None]) @ coefficients.T
        gradient = self.layers.gradient(weights, values, by_last)
        decay = self.decay / len(weights)
        return float(loss + decay * weights @ weights), gradient + 2.0 * decay * weights

    def design(self, units: FloatArray) -> FloatArray:
        """Return weighted columns (n, blocks * (units + terms)) of the hidden layers' values (n, units)."""
        features = np.hstack([units, self.trend])
        return np.asarray((self.multiplier[:, :, None] * features[:, None]).reshape(len(features), -1))

    def solve(self, design: FloatArray) -> FloatArray:
        """Solve for the best last layer (blocks * (units + terms), outputs)."""
        gram = design.T @ design / len(design)
        gram.flat[:: len(gram) + 1] += self._penalty()
        return np.asarray(cho_solve(cho_factor(gram), design.T @ self.target / len(design)))

    def solved(self, weights: FloatArray) -> FloatArray:
        """Solve for the best last layer (blocks * (units + terms), outputs), given hidden weights (numbers,)."""
        return self.solve(self.design(self.layers.values(weights, self.inputs)[-1]))

    def error(self, weights: FloatArray, solution: FloatArray) -> float:
        """Return the mean square residual of the target for hidden weights and a last layer from other rows."""
        rest = self.design(self.layers.values(weights, self.inputs)[-1]) @ solution - self.target
        return float(np.sum(rest**2) / len(rest))

    def _penalty(self) -> FloatArray:
        size = np.mean(self.multiplier**2, axis=0)
        ridges = np.repeat([_RIDGE, _TREND_RIDGE], [self.layers.sizes[-1], self.trend.shape[1]])
        return np.ravel(size[:, None] * ridges)


class _StopSearchError(Exception):
    """Exception with which a callback ends a search."""


@dataclass
class TimedSearch:
    """An L-BFGS-B search that ends at a process time, or after several checks in a row without improvement.

    Attributes:
        deadline: `time.process_time` at which it ends.
        best: weights with the least error so far.
        error: checked error of `best`.
    """

    deadline: float
    best: FloatArray
    error: float = np.inf

    @property
    def is_over(self) -> bool:
        """True after the deadline."""
        return time.process_time() >= self.deadline

    def run(self, loss: Callable[[FloatArray], tuple[float, FloatArray]], check: Callable[[FloatArray], float]) -> None:
        """Search from `best`.

        Args:
            loss: function of weights that returns the loss and its gradient.
            check: function of weights that returns the error by which the best weights are chosen.
        """
        self.error = check(self.best)
        iterations, behind = 0, 0

        def after(weights: FloatArray) -> None:
            nonlocal iterations, behind
            iterations += 1
            if iterations % _CHECK_EVERY == 0 or self.is_over:
                error = check(weights)
                behind = 0 if error < self.error else behind + 1
                if error < self.error:
                    self.best, self.error = weights.copy(), error
            if self.is_over or behind >= _PATIENCE:
                raise _StopSearchError

        options = {"maxcor": 40, "maxiter": 10**6, "maxfun": 10**7, "ftol": 0.0, "gtol": 0.0}
        try:
            after(minimize(loss, self.best, jac=True, method="L-BFGS-B", callback=after, options=options).x)
        except _StopSearchError:
            return


def trained(
    samples: Samples,
    hidden: Layers,
    seconds: float,
    trend_degree: int,
    known: Polynomial | None = None,
    first_rows: int = _FIRST_ROWS,
    rounding: float = _ROUNDING,
) -> NumericRegressor:
    """Train hidden layers, and solve for the last layer and a polynomial trend.

    A fold of the camera positions is left out; its error stops the training of the hidden layers, which starts on a
    random part of the readings. The last layer is then solved on all readings.

    Args:
        samples: samples to fit.
        hidden: layers that take the samples' inputs, scaled to -1..1.
        seconds: process time of the training.
        trend_degree: degree of the polynomial that is fitted together with the last layer.
        known: polynomial of the same inputs; the network is fitted to its residual.
        first_rows: number of readings in the first training.
        rounding: rounding of the values, see `NumericRegressor`.
    """
    deadline = time.process_time() + seconds
    rng = np.random.default_rng(0)
    seen = rng.permutation(np.flatnonzero(samples.fold != 0))
    held_out = ProjectedLoss.of(samples, np.flatnonzero(samples.fold == 0), hidden, trend_degree, known)
    loss = ProjectedLoss.of(samples, seen[:first_rows], hidden, trend_degree, known)

    def check(weights: FloatArray) -> float:
        return held_out.error(weights, loss.solved(weights))

    searches = []
    for size in _PLACE_SIZES:
        start = hidden.start(rng, np.where(samples.is_place, size, 1.0))
        searches.append(TimedSearch(time.process_time() + _TRIAL * seconds, start))
        searches[-1].run(loss, check)
    search = replace(min(searches, key=lambda each: each.error), deadline=deadline)
    rows = first_rows
    while not search.is_over:
        search.run(loss, check)
        if rows >= len(seen):
            break
        rows *= _MORE_ROWS
        loss = ProjectedLoss.of(samples, seen[:rows], hidden, trend_degree, known)
    every = ProjectedLoss.of(samples, np.arange(len(samples)), hidden, trend_degree, known)
    solution = samples.by_block(every.solved(search.best))
    box, orders, weights = samples.readings.box, total_degree(len(samples.is_place), trend_degree), search.best

    def value(inputs: FloatArray) -> FloatArray:
        units = hidden.values(weights, box.scaled(inputs))[-1]
        found = np.hstack([units, basis(inputs, orders, box)]) @ solution
        return found if known is None else found + known(inputs)

    numbers = weights.size + solution.size + (0 if known is None else known.numbers)
    return NumericRegressor(value, box, samples.outputs, numbers, rounding)
