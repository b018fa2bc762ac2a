"""Small neural networks of tanh units: as a regressor, as an offset from a static map, and as a decoder of maps.

As a regressor in the structure "planar" this is the ray bundle's short cut of the neural distortion field (NDF; see
`distortion_field`): what a pixel shows is the same along a ray, so that the field's sum along the ray is not needed.

Training is by variable projection: the last, linear layer is the least-squares solution for the weights of the hidden
layers, so that only those are searched. The loss does not change with the last layer to first order there; therefore
its gradient by the hidden weights is the partial one (Golub and Pereyra, Inverse Problems 19(2) R1, 2003). The search
is `scipy.optimize.minimize` with L-BFGS-B; camera positions that it does not see say when to stop.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Protocol

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize

from wlr_render.numerics.arrays import FloatArray, IntArray
from wlr_render.numerics.polynomial import Polynomial, basis, limited_orders, total_degree
from wlr_render.numerics.regressor import NumericRegressor
from wlr_render.rivals.map_tables import components_with_scores
from wlr_render.rivals.samples import Samples

SECONDS = 3.0
"""Of process time, that a network is trained for."""
_ROUNDING = 1e-10  # the units of the last layer cancel: its weights reach 100 times the values
_RIDGE = 1e-9  # on the last layer, of the mean square of its multipliers
_TREND_RIDGE = 1e-13  # so that terms which the readings do not determine stay small
FIRST_ROWS = 3_000
"""Readings that are trained on first."""
_MORE_ROWS = 4  # times so many when they are learnt
_PLACE_SIZES = (0.1, 0.1, 0.3)  # of first weights, against those of the pixel: maps change slowly with the place
_TRIAL = 0.12  # of the budget, for each of them; the best at held-out positions goes on
_CHECK_EVERY, _PATIENCE = 8, 5  # iterations between checks; checks without a better one
_STATIC_DEGREE = 6
_DECAYS = (1e-6, 1e-4, 1e-2)  # on the decoder's weights; held-out positions choose
_COUNTS = (3, 6, 10, 14)
_DECODER_ITERATIONS = 60


class Layers(Protocol):
    """Hidden layers whose weights are one flat array: `TanhLayers`, or `distortion_field.RayLayers`."""

    @property
    def sizes(self) -> tuple[int, ...]:
        """Numbers of units; the last is that of the values that the linear layer takes."""

    def start(self, rng: np.random.Generator, size: FloatArray) -> FloatArray:
        """Random weights; `size` (variables,) multiplies those of each input."""

    def values(self, weights: FloatArray, inputs: FloatArray) -> list[FloatArray]:
        """The values (n, sizes[-1]) for inputs (n, variables) are the last; `gradient` needs the others."""

    def gradient(
        self, weights: FloatArray, values: list[FloatArray], by_last: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Derivative of a loss by the weights, and by the inputs of the first layer."""


@dataclass(frozen=True)
class TanhLayers:
    """Fully connected layers of tanh units whose weights are one flat array.

    Attributes:
        sizes: numbers of inputs and of the units of each layer.
    """

    sizes: tuple[int, ...]

    @property
    def numbers(self) -> int:
        """Weights and biases."""
        return sum((before + 1) * after for before, after in pairwise(self.sizes))

    def start(self, rng: np.random.Generator, size: FloatArray) -> FloatArray:
        """Random weights (numbers,) for inputs within -1..1; `size` (sizes[0],) multiplies those of each input."""
        parts = []
        for before, after in pairwise(self.sizes):
            parts += [rng.normal(0.0, before**-0.5, (before, after)), rng.uniform(-1.0, 1.0, after)]
        parts[0] *= size[:, None]
        return np.concatenate([np.ravel(part) for part in parts])

    def values(self, weights: FloatArray, inputs: FloatArray) -> list[FloatArray]:
        """The inputs (n, sizes[0]), then the values (n, size) of each layer."""
        found = [inputs]
        for matrix, bias in self._parts(weights):
            found.append(np.tanh(found[-1] @ matrix + bias))
        return found

    def gradient(
        self, weights: FloatArray, values: list[FloatArray], by_last: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Derivatives of a loss by the weights (numbers,) and by the inputs (n, sizes[0]).

        Args:
            weights: (numbers,). values: of `values`.
            by_last: (n, sizes[-1]) derivative of the loss by the last layer's values.
        """
        found: list[FloatArray] = []
        by = by_last
        for (matrix, _), (before, after) in reversed(list(zip(self._parts(weights), pairwise(values), strict=True))):
            by = by * (1.0 - after * after)
            found = [np.ravel(before.T @ by), by.sum(axis=0), *found]
            by = by @ matrix.T
        return np.concatenate(found), by

    def _parts(self, weights: FloatArray) -> list[tuple[FloatArray, FloatArray]]:
        parts, at = [], 0
        for before, after in pairwise(self.sizes):
            middle, end = at + before * after, at + (before + 1) * after
            parts.append((weights[at:middle].reshape(before, after), weights[middle:end]))
            at = end
        return parts


@dataclass(frozen=True, eq=False)
class ProjectedLoss:
    """Mean square that hidden layers, a trend and their best last layer leave of a target, as a function of the former.

    target = sum over blocks b of multiplier_b ([hidden units, trend] @ coefficients_b).

    Attributes:
        layers: the hidden ones.
        inputs: (n, variables), -1..1. trend: (n, terms).
        multiplier: (n, blocks) with the weights of the rows.
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
        """Of some rows of samples, with a polynomial trend; `known` is taken off the observed values first."""
        readings = samples.readings
        trend = basis(readings.inputs[rows], total_degree(len(samples.is_place), degree), readings.box)
        multiplier = readings.multiplier[rows] * readings.weight[rows, None]
        return cls(layers, samples.scaled[rows], trend, multiplier, samples.target(known, rows))

    def __call__(self, weights: FloatArray) -> tuple[float, FloatArray]:
        """Loss, and its gradient by the hidden weights (numbers,)."""
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
        gradient, _ = self.layers.gradient(weights, values, by_last)
        decay = self.decay / len(weights)
        return float(loss + decay * weights @ weights), gradient + 2.0 * decay * weights

    def design(self, units: FloatArray) -> FloatArray:
        """Weighted columns (n, blocks * (units + terms)) of values (n, units) of the hidden layers."""
        features = np.hstack([units, self.trend])
        return np.asarray((self.multiplier[:, :, None] * features[:, None]).reshape(len(features), -1))

    def solve(self, design: FloatArray) -> FloatArray:
        """The best last layer, (blocks * (units + terms), outputs)."""
        gram = design.T @ design / len(design)
        gram.flat[:: len(gram) + 1] += self._penalty()
        return np.asarray(cho_solve(cho_factor(gram), design.T @ self.target / len(design)))

    def solved(self, weights: FloatArray) -> FloatArray:
        """`solve` for hidden weights."""
        return self.solve(self.design(self.layers.values(weights, self.inputs)[-1]))

    def error(self, weights: FloatArray, solution: FloatArray) -> float:
        """Mean square that hidden weights and a last layer, solved elsewhere, leave here."""
        rest = self.design(self.layers.values(weights, self.inputs)[-1]) @ solution - self.target
        return float(np.sum(rest**2) / len(rest))

    def _penalty(self) -> FloatArray:
        size = np.mean(self.multiplier**2, axis=0)
        ridges = np.repeat([_RIDGE, _TREND_RIDGE], [self.layers.sizes[-1], self.trend.shape[1]])
        return np.ravel(size[:, None] * ridges)


class _StopSearchError(Exception):
    """Ends a search from its callback."""


@dataclass
class Search:
    """A search by L-BFGS-B that ends with a budget of process time, or when its checks stay behind the best one.

    Attributes:
        deadline: `time.process_time` at which it ends.
        best: weights of the least error so far.
        error: at them.
        evaluations: of the loss so far.
    """

    deadline: float
    best: FloatArray
    error: float = np.inf
    evaluations: int = 0

    @property
    def is_over(self) -> bool:
        """Whether the budget is spent."""
        return time.process_time() >= self.deadline

    def run(
        self,
        loss: Callable[[FloatArray], tuple[float, FloatArray]],
        check: Callable[[FloatArray], float],
        every: int = _CHECK_EVERY,
    ) -> None:
        """Go on from `best` with a loss that returns its gradient, too; `check` gives the error that decides."""
        self.error = check(self.best)
        iterations, behind = 0, 0

        def counted(weights: FloatArray) -> tuple[float, FloatArray]:
            self.evaluations += 1
            return loss(weights)

        def after(weights: FloatArray) -> None:
            nonlocal iterations, behind
            iterations += 1
            if iterations % every == 0 or self.is_over:
                error = check(weights)
                behind = 0 if error < self.error else behind + 1
                if error < self.error:
                    self.best, self.error = weights.copy(), error
            if self.is_over or behind >= _PATIENCE:
                raise _StopSearchError

        options = {"maxcor": 40, "maxiter": 10**6, "maxfun": 10**7, "ftol": 0.0, "gtol": 0.0}
        try:
            after(minimize(counted, self.best, jac=True, method="L-BFGS-B", callback=after, options=options).x)
        except _StopSearchError:
            return


def network(
    samples: Samples,
    seconds: float = SECONDS,
    layers: tuple[int, ...] = (32, 32),
    trend_degree: int = 3,
    known: Polynomial | None = None,
) -> NumericRegressor:
    """Fit tanh layers and a polynomial trend.

    A fold of the camera positions is held out and stops the training of the hidden layers, which starts on a random
    part of the readings; the last layer is then solved on all of them.

    Args:
        samples: what to fit.
        seconds: process time of the training.
        layers: numbers of hidden units.
        trend_degree: of the polynomial that is fitted together with the last layer.
        known: of the same inputs; the network is fitted to what it leaves.
    """
    return trained(samples, TanhLayers((len(samples.is_place), *layers)), seconds, trend_degree, known)


def trained(
    samples: Samples,
    hidden: Layers,
    seconds: float,
    trend_degree: int,
    known: Polynomial | None = None,
    first_rows: int = FIRST_ROWS,
    rounding: float = _ROUNDING,
) -> NumericRegressor:
    """Train hidden layers as `network` says.

    Args:
        samples, seconds, trend_degree, known: see `network`.
        hidden: layers that take the samples' inputs, scaled to -1..1.
        first_rows: readings that are trained on first.
        rounding: of the values, see `NumericRegressor`.
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
        searches.append(Search(time.process_time() + _TRIAL * seconds, start))
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


def offset_network(samples: Samples, seconds: float = SECONDS, layers: tuple[int, ...] = (32, 32)) -> NumericRegressor:
    """Fit a network to the offset from a static map: that of the camera position nearest to the centre of all.

    As HUDNet (Displays, 2023) and direct distortion prediction (Yu et al., Applied Optics 62(21) 5720, 2023) do for
    head-up displays in the structure "volumetric", as far as their abstracts go; their layers and losses differ.
    """
    positions = range(int(samples.position.max()) + 1)
    place = samples.scaled[:, samples.is_place]
    distance = [np.linalg.norm(place[samples.position == each].mean(axis=0)) for each in positions]
    rows = np.flatnonzero(samples.position == int(np.argmin(distance)))
    places = int(samples.is_place.sum())
    orders = limited_orders(2, _STATIC_DEGREE, places, 0, _STATIC_DEGREE)
    by_column = np.empty_like(orders)
    by_column[:, ~samples.is_place], by_column[:, samples.is_place] = orders[:, :2], orders[:, 2:]
    box = samples.readings.box
    design = samples.design(basis(samples.readings.inputs[rows], by_column, box), rows)
    solution = np.linalg.lstsq(design, samples.target(rows=rows), rcond=1e-10)[0]
    static = Polynomial(by_column, box, samples.by_block(np.asarray(solution)))
    return network(samples, seconds, layers, trend_degree=0, known=static)


def decoded_components(samples: Samples) -> NumericRegressor:
    """Fit a decoder of maps: a network of the place gives the scores of the maps' principal components.

    OSTNet (Someya et al., 2019) in form: a network that gives a distortion map for a viewpoint. Its own decoder was
    larger; held-out positions choose the number of components and the decay of the weights.
    """
    return components_with_scores(samples, _COUNTS, _DECAYS, _decoder)


def _decoder(place: FloatArray, scores: FloatArray, decay: float) -> tuple[Callable[[FloatArray], FloatArray], int]:
    """Scores (k, count) as a network of places (k, variables), and its numbers."""
    hidden = TanhLayers((place.shape[1], 32, 32))
    size = float(np.sqrt(np.mean(scores**2))) or 1.0

    def terms(place: FloatArray) -> FloatArray:
        return np.column_stack([np.ones(len(place)), place])

    loss = ProjectedLoss(hidden, place, terms(place), np.ones((len(place), 1)), scores / size, decay)
    options = {"maxiter": _DECODER_ITERATIONS}
    weights = minimize(
        loss,
        hidden.start(np.random.default_rng(0), np.ones(place.shape[1])),
        jac=True,
        method="L-BFGS-B",
        options=options,
    ).x
    solution = loss.solved(weights) * size
    return (
        lambda wanted: np.hstack([hidden.values(weights, wanted)[-1], terms(wanted)]) @ solution,
        weights.size + solution.size,
    )
