"""Weighted polynomial regression with cross-validated degree choice, shared by all fits.

Rows are compressed fold by fold to the R of a QR decomposition, which keeps every sum of squares: any training set is
then a few stacked triangles, and since terms are ordered by total degree, one pass over the data serves all lower
degrees too. The design of all rows is never held at once.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np

from wlr_render.geometry.directions import ARCMIN
from wlr_render.numerics.arrays import FloatArray, IntArray
from wlr_render.numerics.least_squares import RankDeficientError, Solution, solve
from wlr_render.numerics.polynomial import Box, Polynomial, basis, term_count, total_degree

HIGHEST_DEGREE = 7
"""Of the degrees tried when none is given; the shipped devices reach 0.04' there."""
RANK_TOLERANCE = 1e-8
"""Singular values below this fraction of the largest count as zero; sound designs stay above 1e-5."""
FOLDS = 10
_BLOCK = 8_192  # samples per compression step
_BOX_MARGIN = 0.025  # of the box per side: half a cell of the coarsest usual grid, 20 samples across the panel


def angular_metric(tangents: FloatArray) -> FloatArray:
    """Arcminutes per unit of tangent at tangents (n, 2): (n,).

    With n^2 = 1 + tx^2 + ty^2 a small step of tangents is an angle of 1 / n^2 of it radially and 1 / n across; camera
    noise is the same in both. Their geometric mean is taken (within 8 % of either at 30 degrees off axis), so that one
    design serves both outputs.
    """
    square = 1.0 + np.sum(tangents**2, axis=-1)
    return np.asarray(square**-0.75 / ARCMIN)


def relative_sigma(sigma: FloatArray) -> FloatArray:
    """Sigmas (n,) to weight by: as they are, or ones where the data are stated to be exact (all zero)."""
    return sigma if np.any(sigma > 0) else np.ones_like(sigma)


@dataclass(frozen=True)
class Regression:
    """observed[:, r] ~ sum over b of multiplier[:, r, b] * polynomial_b(inputs), for n samples.

    A plain polynomial has one row r and one block b with multiplier 1. A deviation A + B / depth has the two blocks
    1 and 1 / depth.

    Attributes:
        inputs: (n, variables).
        observed: (n, rows, outputs).
        multiplier: (n, rows, blocks).
        metric: (n,) turns a residual into the reported unit (arcminutes or pixels).
        sigma: (n,) its standard deviation up to a common factor.
        group: (n,) what is left out together in held-out tests.
    """

    inputs: FloatArray
    observed: FloatArray
    multiplier: FloatArray
    metric: FloatArray
    sigma: FloatArray
    group: IntArray

    @classmethod
    def plain(
        cls, inputs: FloatArray, observed: FloatArray, metric: FloatArray, sigma: FloatArray, group: IntArray
    ) -> "Regression":
        """Of one polynomial: observed (n, outputs)."""
        return cls(inputs, observed[:, None], np.ones((len(inputs), 1, 1)), metric, sigma, group)

    @property
    def blocks(self) -> int:
        """Number of polynomials that share the inputs."""
        return int(self.multiplier.shape[2])


@dataclass(frozen=True)
class HeldOut:
    """Error on camera positions that were left out of the fit, for one degree.

    Attributes:
        degree: total degree N.
        rms: root mean square length of the residual vector, over all positions, each left out once.
        standard_error: of `rms`, from its spread over the folds.
    """

    degree: int
    rms: float
    standard_error: float


@dataclass(frozen=True)
class Fitted:
    """A fitted polynomial; its outputs are those of block 0, then block 1, and so on.

    Attributes:
        polynomial: over the samples' box, grown by a margin.
        degree: its total degree.
        condition: of the scaled design.
        cross_validate: returns `held_out`, at the cost of one solve per fold and degree.
    """

    polynomial: Polynomial
    degree: int
    condition: float
    cross_validate: Callable[[], tuple[HeldOut, ...]]

    @property
    def held_out(self) -> tuple[HeldOut, ...]:
        """Error per degree tried, ascending; degrees that the training sets cannot determine are missing."""
        return self.cross_validate()


@dataclass(frozen=True)
class _Fold:
    """One fold's weighted rows [design | observed], compressed, and its sum of 1 / sigma^2."""

    triangle: FloatArray
    information: float


def fit(regression: Regression, degree: int | None) -> Fitted:
    """Fit at one degree, or at the lowest that is within one standard error of the best on held-out groups.

    Raises:
        RankDeficientError: the samples do not determine the coefficients (with no degree given: not even of degree 1).
    """
    box = Box.around(regression.inputs)
    margin = _BOX_MARGIN * (box.high - box.low)
    box = Box(box.low - margin, box.high + margin)
    top = _highest_degree(regression) if degree is None else degree
    folds = [_compressed(regression, rows, top, box) for rows in _fold_rows(regression.group)]
    tried = range(1, top + 1) if degree is None else [degree]

    @cache
    def cross_validated() -> tuple[HeldOut, ...]:
        return tuple(entry for d in tried if (entry := _held_out(regression, folds, top, d)) is not None)

    chosen = _lowest_good(cross_validated()) if degree is None else degree
    solution = _solved(regression, folds, top, chosen)
    return Fitted(_polynomial(regression, box, chosen, solution), chosen, solution.condition, cross_validated)


def _highest_degree(regression: Regression) -> int:
    """Of those whose columns could be determined by the number of rows."""
    rows = regression.observed.shape[0] * regression.observed.shape[1]
    variables = regression.inputs.shape[1]
    degrees = range(HIGHEST_DEGREE, 1, -1)
    return next((d for d in degrees if regression.blocks * term_count(variables, d) <= rows), 1)


def _fold_rows(group: IntArray) -> list[IntArray]:
    """Sample indices of each fold. Groups are dealt in a shuffled order: neighbours must not leave together."""
    names, position = np.unique(group, return_inverse=True)
    fold = np.random.default_rng(0).permutation(len(names)) % FOLDS
    return [np.flatnonzero(fold[position] == k) for k in range(min(FOLDS, len(names)))]


def _compressed(regression: Regression, samples: IntArray, degree: int, box: Box) -> _Fold:
    outputs = regression.observed.shape[2]
    columns = regression.blocks * term_count(regression.inputs.shape[1], degree)
    triangle = np.empty((0, columns + outputs))
    for first in range(0, len(samples), _BLOCK):
        rows = _weighted_rows(regression, samples[first : first + _BLOCK], degree, box)
        triangle = np.asarray(np.linalg.qr(np.concatenate([triangle, rows]), mode="r"))
    return _Fold(triangle, float(np.sum(regression.sigma[samples] ** -2.0)))


def _weighted_rows(regression: Regression, samples: IntArray, degree: int, box: Box) -> FloatArray:
    phi = basis(regression.inputs[samples], total_degree(regression.inputs.shape[1], degree), box)
    design = np.einsum("nrb,nt->nrbt", regression.multiplier[samples], phi)
    count, rows = design.shape[:2]
    whole = np.concatenate([design.reshape(count, rows, -1), regression.observed[samples]], axis=2)
    weight = regression.metric[samples] / regression.sigma[samples]
    return (whole * weight[:, None, None]).reshape(count * rows, -1)


def _columns(regression: Regression, top: int, degree: int) -> IntArray:
    """Columns of the design at degree `top` that belong to the terms of `degree` and lower."""
    low = total_degree(regression.inputs.shape[1], top).sum(axis=1) <= degree
    return np.flatnonzero(np.tile(low, regression.blocks))


def _solved(regression: Regression, folds: list[_Fold], top: int, degree: int) -> Solution:
    rows = np.concatenate([fold.triangle for fold in folds])
    outputs = regression.observed.shape[2]
    return solve(rows[:, _columns(regression, top, degree)], rows[:, -outputs:], tolerance=RANK_TOLERANCE)


def _held_out(regression: Regression, folds: list[_Fold], top: int, degree: int) -> HeldOut | None:
    """Error of each fold predicted from the others, or None where some training set is not enough."""
    if len(folds) < 2:
        return None
    columns, outputs = _columns(regression, top, degree), regression.observed.shape[2]
    squares = []
    for k, fold in enumerate(folds):
        try:
            solution = _solved(regression, folds[:k] + folds[k + 1 :], top, degree)
        except RankDeficientError:
            return None
        miss = fold.triangle[:, columns] @ solution.coefficients - fold.triangle[:, -outputs:]
        squares.append(np.sum(miss**2))
    information = np.array([fold.information for fold in folds])
    mean_square = np.array(squares) / information
    rms = float(np.sqrt(np.sum(squares) / information.sum()))
    standard_error = float(mean_square.std(ddof=1) / np.sqrt(len(folds)))
    return HeldOut(degree, rms, 0.5 * standard_error / rms if rms > 0 else 0.0)


def _lowest_good(held_out: tuple[HeldOut, ...]) -> int:
    if not held_out:
        return 1
    best = min(held_out, key=lambda entry: entry.rms)
    return next(entry.degree for entry in held_out if entry.rms <= best.rms + best.standard_error)


def _polynomial(regression: Regression, box: Box, degree: int, solution: Solution) -> Polynomial:
    outputs = regression.observed.shape[2]
    by_block = solution.coefficients.reshape(regression.blocks, -1, outputs)
    terms = by_block.shape[1]
    orders = total_degree(regression.inputs.shape[1], degree)
    return Polynomial(orders, box, np.ascontiguousarray(by_block.transpose(1, 0, 2).reshape(terms, -1)))
