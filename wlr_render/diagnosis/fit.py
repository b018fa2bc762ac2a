"""Fit the values of an explanation's causes to the observations, and the evidence for the explanation.

Gauss-Newton with Levenberg's damping (D. W. Marquardt, "An Algorithm for Least-Squares Estimation of Nonlinear
Parameters", SIAM J. 11 (1963) 431). Evidence: reduced chi-squared, marginal likelihood, held-out captures, and
stability across halves of the readings.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from wlr_render.diagnosis.cause import Role
from wlr_render.diagnosis.observations import DISPLAY, SEE_THROUGH, Observations
from wlr_render.diagnosis.prediction import Explanation, Linearisation, Predictor, State
from wlr_render.diagnosis.settings import DEFAULT, Settings
from wlr_render.numerics.arrays import BoolArray, FloatArray, IntArray

_ITERATIONS = 12
_SETTLED = 1e-2  # of chi-squared: a step that gains less ends the iteration; steps shrink quadratically
_PRIOR = 1e-8  # information of an almost boundless prior, in prior sigmas: keeps degenerate directions finite
_SPREADS = 4.0  # standard deviations above its mean up to which the square of a change may be noise
_HELD = 1e-2  # of the whole information: a half that determines less of a parameter does not move it


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


def reduced_chi_squared(found: Fit) -> float:
    """Mean square of the used residuals per degree of freedom: 1 where only noise is left."""
    return float(found.chi_squared / max(1, 2 * int(found.used.sum()) - found.at.free.size))


def minus_two_log_evidence(found: Fit, settings: Settings = DEFAULT) -> float:
    """-2 log of the explanation's marginal likelihood, up to a constant: lower is better.

    Laplace's approximation with a normal prior for every parameter (D. MacKay, "Information Theory, Inference, and
    Learning Algorithms", 2003, chapter 28): a parameter that could have been anything pays for having been tuned. A
    cause whose values are multiples of a whole step pays for the choice of the multiple only.

    What an explanation leaves above the noise counts as noise of unknown size in each part of the session by itself.
    So an explanation of one whole part is worth more than one that explains a little of both.
    """
    likelihood = 0.0
    for count, squares in found.by_part:
        variance = max(1.0, squares / count)
        likelihood += count * np.log(variance) + squares / variance
    values, parameters = found.explanation.vector(), found.explanation.parameters()
    prior_sigma = np.array([parameter.prior_sigma for parameter in parameters])
    whole, off_step = _whole_steps(found)
    free = ~whole[found.at.free]
    sizes = (values / prior_sigma)[found.at.free][free]
    _, log_determinant = np.linalg.slogdet(found.information[np.ix_(free, free)] + np.eye(int(free.sum())))
    choices = 2.0 * np.log(settings.whole_step_choices) * int(whole.sum())
    return float(likelihood + sizes @ sizes + log_determinant + off_step + choices)


def _whole_steps(found: Fit) -> tuple[BoolArray, float]:
    """Which parameters move in whole steps (p,), and the chi-squared of rounding them."""
    whole, off_step, first = np.zeros(len(found.explanation.vector()), dtype=bool), 0.0, 0
    for hypothesis, values in zip(found.explanation.hypotheses, found.explanation.values, strict=True):
        step, rows = hypothesis.cause.whole_steps, np.arange(first, first + len(values))
        first += len(values)
        if step is None:
            continue
        whole[rows] = True
        prior_sigma = np.array([parameter.prior_sigma for parameter in hypothesis.cause.parameters])
        places = np.flatnonzero(np.isin(found.at.free, rows))
        off = ((values - step * np.round(values / step)) / prior_sigma)[found.at.free[places] - rows[0]]
        off_step += float(off @ np.linalg.solve(found.covariance[np.ix_(places, places)], off))
    return whole, off_step


def is_physical(found: Fit, settings: Settings = DEFAULT) -> bool:
    """Whether all values are possible: above their minimum, to three standard errors, and of a usual size."""
    parameters, values = found.explanation.parameters(), found.explanation.vector()
    minimum = np.array([parameter.minimum for parameter in parameters])
    sizes = np.array([parameter.role is Role.SIZE for parameter in parameters])
    prior_sigma = np.array([parameter.prior_sigma for parameter in parameters])
    usual = np.abs(values[sizes]) <= settings.max_prior_sigmas * prior_sigma[sizes]
    return bool(np.all(values >= minimum - 3.0 * found.sigmas()) and np.all(usual))


def correlation_condition(found: Fit) -> float:
    """Condition number of the correlations between the fitted values: 1 where each is known by itself."""
    return float(np.linalg.cond(correlation_matrix(found))) if found.at.free.size else 1.0


def correlation_matrix(found: Fit) -> FloatArray:
    """Correlations (p, p) between the free parameters of a fit."""
    sigma = np.sqrt(np.diag(found.covariance))
    return np.asarray(found.covariance / sigma / sigma[:, None])


def p_value(gain: float, parameters: int, tries: int) -> float:
    """Probability that the best of `tries` causes of no effect gains so much chi-squared with so many parameters."""
    return float(min(1.0, tries * chdtrc(parameters, max(gain, 0.0))))


@dataclass(frozen=True)
class HeldOutImprovement:
    """How much closer held-out captures are predicted.

    Attributes:
        percent: reduction of their rms residual.
        sigma: one standard error of that, from the spread of the captures' differences.
        significance: mean difference of the captures' squared residuals over its standard error.
    """

    percent: float
    sigma: float
    significance: float


def held_out_squares(found: Fit, group: IntArray, groups: int) -> FloatArray:
    """Sum of squared residuals of each capture (groups,) when it is left out of the fit; NaN for unused captures.

    The fit without a capture is one Newton step from the fit with it, which is exact for what is left to change.
    """
    rows = np.flatnonzero(found.used)
    jacobian, residual, owner = found.at.jacobian[rows], found.residual[rows], group[rows]
    squares, count = np.full(groups, np.nan), jacobian.shape[-1]
    for number in np.unique(owner):
        mine = owner == number
        left = residual[mine]
        if count:
            flat = jacobian[mine].reshape(2 * int(mine.sum()), count)
            change = np.linalg.lstsq(found.information - flat.T @ flat, flat.T @ left.ravel(), rcond=None)[0]
            left = left + jacobian[mine] @ change
        squares[number] = np.sum(left**2)
    return squares


def held_out_improvement(before: FloatArray, after: FloatArray) -> HeldOutImprovement:
    """Compare two fits by their held-out squares per capture (groups,); captures that either lacks are left out."""
    both = np.isfinite(before) & np.isfinite(after)
    old, new = before[both], after[both]
    difference = old - new
    error = float(np.std(difference, ddof=1) * np.sqrt(len(old)))
    ratio = float(np.sqrt(new.sum() / old.sum()))
    # Leave-one-capture-out values of the ratio give its standard error.
    ratios = np.sqrt((new.sum() - new) / (old.sum() - old))
    spread = float(np.sqrt((len(old) - 1) / len(old) * np.sum((ratios - ratios.mean()) ** 2)))
    return HeldOutImprovement(100 * (1 - ratio), 100 * spread, float(difference.sum()) / error if error > 0 else 0.0)


def instability(observations: Observations, found: Fit) -> FloatArray:
    """For each cause of a fit, the largest change of its effect between two halves of the readings, over the effect.

    A spurious match fits one half of the readings with one value and the other half with another. The halves are near
    and far from the image's centre, left and right, top and bottom, of the stage's x and y, and early and late. What
    noise alone may change is taken off. 0 is stable; near 1 and above there is no such cause.
    """
    owners = np.repeat(np.arange(len(found.explanation.values)), [len(v) for v in found.explanation.values])
    owners = owners[found.at.free]
    prior_sigma = np.array([parameter.prior_sigma for parameter in found.explanation.parameters()])
    effect = (found.explanation.vector() / prior_sigma)[found.at.free]
    worst = np.zeros(len(found.explanation.values))
    scale = reduced_chi_squared(found)
    for half in _halves(observations):
        first, second = (_solved(found, found.used & rows) for rows in (half, ~half))
        change, covariance = first[0] - second[0], scale * (first[1] + second[1])
        for cause in range(len(worst)):
            mine = owners == cause
            weight = found.information[np.ix_(mine, mine)]
            noise = weight @ covariance[np.ix_(mine, mine)]
            usual = float(np.trace(noise) + _SPREADS * np.sqrt(2.0 * np.trace(noise @ noise)))
            moved = max(0.0, float(change[mine] @ weight @ change[mine]) - usual)
            size = float(effect[mine] @ weight @ effect[mine])
            worst[cause] = max(worst[cause], float(np.sqrt(moved / size)) if size > 0 else 0.0)
    return worst


def _solved(found: Fit, rows: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Change of the free parameters, and their covariance, by some rows alone; they stay where rows say nothing."""
    jacobian = found.at.jacobian[rows].reshape(2 * int(rows.sum()), found.at.free.size)
    covariance = np.asarray(np.linalg.inv(jacobian.T @ jacobian + _HELD * found.information))
    return covariance @ (jacobian.T @ found.residual[rows].ravel()), covariance


def _halves(observations: Observations) -> list[BoolArray]:
    """Masks (n,) of one half each, split at the median of every part."""
    plan, readings = observations.session.plan, observations.session.readings
    columns: dict[int, list[FloatArray]] = {}
    centre = observations.nominal.camera.centre_px
    for part, table, pixel in (
        (DISPLAY, plan.display, None if plan.display is None else plan.display.camera_pixel),
        (SEE_THROUGH, plan.see_through, readings.dot_pixel),
    ):
        if table is not None and pixel is not None:
            radius = np.linalg.norm(pixel - centre, axis=1)
            columns[part] = [radius, pixel[:, 0], pixel[:, 1], table.stage[:, 0], table.stage[:, 1], table.time_s]
    if not columns:
        return []
    halves = []
    for number in range(6):
        half = np.zeros(len(observations), dtype=bool)
        for part, variables in columns.items():
            half[observations.part == part] = variables[number] > np.median(variables[number])
        halves.append(half)
    return halves
