"""Fit the values of an explanation's causes to the observations: Gauss-Newton with Levenberg's damping.

D. W. Marquardt, "An Algorithm for Least-Squares Estimation of Nonlinear Parameters", SIAM J. 11 (1963) 431.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from wlr_render.diagnosis.prediction import Explanation, Linearisation, Predictor, State
from wlr_render.numerics.arrays import BoolArray, FloatArray

_ITERATIONS = 12
_SETTLED = 1e-2  # of chi-squared: a step that gains less ends the iteration; steps shrink quadratically
_PRIOR = 1e-8  # information of an almost boundless prior, in prior sigmas: keeps degenerate directions finite


@dataclass(frozen=True, eq=False)
class Fit:
    """A fitted explanation.

    Attributes:
        explanation: with the fitted values.
        residual: (n, 2) measured minus predicted, units of sigma.
        chi_squared: its sum of squares over the readings that were used.
        by_part: number of values and sum of squares in each part of the session that was used.
        used: (n,) which were.
        at: the linearisation at the solution.
        information: (p, p) Fisher information on the free parameters in prior sigmas, for noise of sigma.
    """

    explanation: Explanation
    residual: FloatArray
    chi_squared: float
    by_part: tuple[tuple[int, float], ...]
    used: BoolArray
    at: Linearisation
    information: FloatArray

    @cached_property
    def covariance(self) -> FloatArray:
        """Of the free parameters (p, p) in prior sigmas, for noise of sigma."""
        return np.asarray(np.linalg.inv(self.information))

    def sigmas(self) -> FloatArray:
        """One standard deviation of all parameters, in their units; 0 for those that are not free."""
        prior_sigma = np.array([parameter.prior_sigma for parameter in self.explanation.parameters()])
        sigma = np.zeros(len(prior_sigma))
        sigma[self.at.free] = np.sqrt(np.diag(self.covariance))
        return np.asarray(sigma * prior_sigma)


def fit(
    predictor: Predictor, start: Explanation, used: BoolArray, iterations: int = _ITERATIONS, near: State | None = None
) -> Fit:
    """Fit all causes of an explanation together, from its values on.

    Args:
        predictor: of the observations.
        start: what to fit, and from where.
        used: (n,) the readings that count.
        iterations: Gauss-Newton steps at most.
        near: a state near the start, if one is known.
    """
    at = predictor.linearised(start, predictor.state(start, near))
    used = used & np.isfinite(at.residual).all(axis=1)
    chi_squared, damping = _chi_squared(at.residual, used), 1e-6
    for _ in range(iterations):
        if at.free.size == 0:
            break
        stepped = _stepped(predictor, at, used, chi_squared, damping)
        if stepped is None:
            break
        trial, state, found, damping = stepped
        gained, chi_squared = chi_squared - found, found
        at = predictor.linearised(trial, state)
        if gained < _SETTLED:
            break
    by_part = _by_part(predictor.observations.part[used], at.residual[used])
    return Fit(at.explanation, at.residual, chi_squared, by_part, used, at, _information(at, used))


def _stepped(
    predictor: Predictor, at: Linearisation, used: BoolArray, chi_squared: float, damping: float
) -> tuple[Explanation, State, float, float] | None:
    """The next explanation, its state and chi-squared, and the damping to go on with; None where no step helps."""
    information = _information(at, used)
    gradient = np.einsum("nkp,nk->p", at.jacobian[used], at.residual[used])
    prior_sigma = np.array([parameter.prior_sigma for parameter in at.explanation.parameters()])
    for _ in range(8):
        step = np.linalg.solve(information + damping * np.diag(np.diag(information)), gradient)
        moved = at.explanation.vector()
        moved[at.free] += step * prior_sigma[at.free]
        trial = at.explanation.at(moved)
        state = predictor.state(trial, at.state)
        found = _chi_squared(predictor.residual_of(state), used)
        if found < chi_squared:
            return trial, state, found, 0.1 * damping
        if float(gradient @ step) < _SETTLED:
            return None
        damping = max(10.0 * damping, 1e-4)
    return None


def _by_part(part: NDArray[np.int64], residual: FloatArray) -> tuple[tuple[int, float], ...]:
    squares = np.sum(residual**2, axis=1)
    return tuple((2 * int(np.sum(part == each)), float(squares[part == each].sum())) for each in np.unique(part))


def _chi_squared(residual: FloatArray, used: BoolArray) -> float:
    """Sum of squares; infinite where a reading that counts has lost its prediction."""
    with np.errstate(over="ignore"):
        total = float(np.sum(residual[used] ** 2))
    return total if np.isfinite(total) else np.inf


def _information(at: Linearisation, used: BoolArray) -> FloatArray:
    rows = at.jacobian[used].reshape(2 * int(used.sum()), at.free.size)
    return np.asarray(rows.T @ rows + _PRIOR * np.eye(rows.shape[1]))
