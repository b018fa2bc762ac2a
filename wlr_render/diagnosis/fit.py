"""Fit the values of an explanation's causes to the readings of a bench, and the evidence for the explanation.

Readings of a bench have three errors: noise, noise that neighbours share, and a random motion of the camera in each
capture (`weighed_readings`, `scatter`). The fit is Gauss-Newton with Levenberg's damping (D. W. Marquardt, "An
Algorithm for Least-Squares Estimation of Nonlinear Parameters", SIAM J. 11 (1963) 431) on whitened readings.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import numpy as np
import scipy

from wlr_render.captures.session import SessionPlan
from wlr_render.diagnosis.cause import Role
from wlr_render.diagnosis.observations import RUN_TIME, Observations
from wlr_render.diagnosis.prediction import Explanation, Linearisation, Predictor, State
from wlr_render.diagnosis.settings import DEFAULT, Settings
from wlr_render.diagnosis.weighed_readings import WeighedReadings, Whitening
from wlr_render.numerics.arrays import FloatArray, IntArray
from wlr_render.numerics.scatter import Known, Scatter, ScatterSums, cost, marginal
from wlr_render.numerics.scatter_search import best_scatter

_ITERATIONS = 12
_SETTLED = 1e-2  # fall of chi-squared in a step below which the iteration ends; convergence is quadratic
_ROUGHLY = 0.5  # the same for fits that are only compared
_AS_PROMISED = 0.1  # relative difference from the predicted gain below which derivatives are kept
_SAME_SCATTER = 0.1  # change of the logarithm of a noise or motion size below which the values are not fitted again
_FEWEST = 2  # fewest captures on either side of a time: a single one is a capture that moved
_MOST_STEPS = 4  # largest number of whole steps from the best multiple in the sum
_ANY = 1e4  # prior standard deviation, in prior sigmas, that leaves a value free


@dataclass(frozen=True, eq=False)
class Fit:
    """A fitted explanation.

    Attributes:
        at: the linearisation at the solution, in units of sigma.
        scatter: sizes of noise and motions.
        residual: (n, 2) whitened residual, measured minus predicted.
        jacobian: (n, 2, p) whitened Jacobian of the predicted readings by the free parameters in prior sigmas.
        chi_squared: sum of squares of `residual`.
        information: (p, p) information on the free parameters in prior sigmas, including their priors.
        minus_two_log_evidence: -2 log evidence of the readings, up to a constant; lower is better.
    """

    at: Linearisation
    scatter: Scatter
    residual: FloatArray
    jacobian: FloatArray
    chi_squared: float
    information: FloatArray
    minus_two_log_evidence: float

    @property
    def explanation(self) -> Explanation:
        """The causes with the fitted values."""
        return self.at.explanation

    @cached_property
    def covariance(self) -> FloatArray:
        """Covariance (p, p) of the free parameters in prior sigmas."""
        return np.asarray(np.linalg.inv(self.information))

    @cached_property
    def owner(self) -> IntArray:
        """Index (p,) of the cause to which each free value belongs."""
        counts = [len(each) for each in self.explanation.values]
        return np.repeat(np.arange(len(counts)), counts)[self.at.free]

    @cached_property
    def effects(self) -> FloatArray:
        """Free values (p,) in prior sigmas; 0 for SHAPE parameters."""
        sizes = np.array([each.role is Role.SIZE for each in self.explanation.parameters()], dtype=bool)
        values = self.explanation.vector() / self.explanation.prior_sigma
        return np.asarray(np.where(sizes, values, 0.0)[self.at.free])

    def residual_without(self, number: int) -> FloatArray:
        """Return the residual (n, 2), in units of sigma, without one of the causes, to first order."""
        mine = self.owner == number
        return np.asarray(self.at.residual + self.at.jacobian[:, :, mine] @ self.effects[mine])

    def sigmas(self) -> FloatArray:
        """Return the standard errors of all parameters, in their units; 0 for fixed parameters."""
        prior_sigma = self.explanation.prior_sigma
        sigma = np.zeros(len(prior_sigma))
        sigma[self.at.free] = np.sqrt(np.diag(self.covariance))
        return np.asarray(sigma * prior_sigma)


def fit(
    readings: WeighedReadings,
    start: Explanation,
    scatter: Scatter,
    iterations: int = _ITERATIONS,
    vary_scatter: bool = True,
    at: Linearisation | None = None,
    roughly: bool = False,
) -> Fit | None:
    """Fit all causes of an explanation together from start values; None where these do not predict every reading.

    Args:
        readings: the readings to fit.
        start: causes to fit, with their start values.
        scatter: start sizes of noise and motions; the captures that moved stay the same.
        iterations: largest number of Gauss-Newton steps.
        vary_scatter: False if the sizes of noise and motions are known.
        at: the linearisation at the start, if known.
        roughly: whether to reuse derivatives while steps gain as predicted: accurate enough to compare fits.
    """
    at = at or readings.predictor.linearised(start)
    if not np.isfinite(at.residual).all():
        return None
    found = _settled(readings, at, readings.whitening(scatter), iterations, roughly)
    scatter, evidence, off = _evidence(readings, found, scatter, vary_scatter)
    if iterations and off > _SAME_SCATTER and found.free.size:
        found = _settled(readings, found, readings.whitening(scatter), iterations, roughly)
        scatter, evidence, _ = _evidence(readings, found, scatter, vary_scatter)
    whiten = readings.whitening(scatter)
    residual, jacobian = whiten(found.residual), whiten(found.jacobian)
    rows = jacobian.reshape(residual.size, found.free.size)
    information = rows.T @ rows + np.eye(found.free.size)
    return Fit(found, scatter, residual, jacobian, float(np.sum(residual**2)), information, evidence)


def _settled(
    readings: WeighedReadings, at: Linearisation, whiten: Whitening, iterations: int, roughly: bool
) -> Linearisation:
    damping, predictor, enough = 1e-6, readings.predictor, _ROUGHLY if roughly else _SETTLED
    for _ in range(iterations):
        step = _step(predictor, at, whiten, damping) if at.free.size else None
        if step is None:
            break
        explanation, state, gained, promised, damping = step
        as_promised = roughly and abs(gained - promised) < _AS_PROMISED * promised
        # A SHAPE parameter has no derivative while the effect has no size.
        all_known = at.free.size == sum(each.role is not Role.TIME for each in at.explanation.parameters())
        if gained < enough or (as_promised and all_known):
            at = replace(at, explanation=explanation, state=state, residual=predictor.residual_of(state))
        else:
            at = predictor.linearised(explanation, state)
        if gained < enough:
            break
    return at


def _step(
    predictor: Predictor, at: Linearisation, whiten: Whitening, damping: float
) -> tuple[Explanation, State, float, float, float] | None:
    """Return the next step; None if no step helps.

    Returns:
        Explanation and state after the step, the fall of chi-squared, the fall that the derivatives predict, and the
        damping for the next step.
    """
    rows = whiten(at.jacobian).reshape(-1, at.free.size)
    residual, off = whiten(at.residual), at.off_prior
    information = rows.T @ rows + np.eye(len(off))
    gradient = rows.T @ residual.ravel() - off
    before = float(np.sum(residual**2)) + _prior_cost(at.explanation)
    for _ in range(8):
        step = np.linalg.solve(information + damping * np.diag(np.diag(information)), gradient)
        moved = at.explanation.vector()
        moved[at.free] += step * at.explanation.prior_sigma[at.free]
        trial = at.explanation.at(moved)
        state = predictor.state(trial, at.state)
        raw = predictor.residual_of(state)
        if np.isfinite(raw).all():
            after = float(np.sum(whiten(raw) ** 2)) + _prior_cost(trial)
            if after < before:
                promised = 2.0 * float(gradient @ step) - float(step @ information @ step)
                return trial, state, before - after, promised, 0.1 * damping
        if float(gradient @ step) < _SETTLED:
            return None
        damping = max(10.0 * damping, 1e-4)
    return None


def _prior_cost(explanation: Explanation) -> float:
    return float(explanation.off_prior @ explanation.off_prior)


def _evidence(
    readings: WeighedReadings, at: Linearisation, scatter: Scatter, vary: bool
) -> tuple[Scatter, float, float]:
    """Return the sizes of noise and motions at a solution, -2 log evidence, and the largest change of a log size."""
    sums = readings.sums_at(at)
    found, least = best_scatter(sums, scatter) if vary else (scatter, cost(sums, scatter))
    least += whole_step_cost(sums, found, at.explanation, at.free)
    least += 2.0 * float(np.log(choices(at.explanation, readings.observations)))
    return found, least, float(np.max(np.abs(found.vector() - scatter.vector())))


def choices(explanation: Explanation, observations: Observations) -> float:
    """Return the number of combinations of variants and times from which the causes were chosen."""
    count = 1.0
    for hypothesis in explanation.hypotheses:
        count *= len(hypothesis.cause.variants)
        if any(parameter.role is Role.TIME for parameter in hypothesis.cause.parameters):
            count *= max(1, len(times_between_captures(observations.session.plan)))
    return count


def times_between_captures(plan: SessionPlan) -> FloatArray:
    """Return the midpoints between capture times, ascending, with at least `_FEWEST` captures on either side."""
    parts = [part for part in plan.parts if part is not None]
    times = np.unique(np.concatenate([part.time_s for part in parts]))
    return np.asarray(0.5 * (times[1:] + times[:-1]))[_FEWEST - 1 : len(times) - _FEWEST]


def whole_step_cost(sums: ScatterSums, scatter: Scatter, explanation: Explanation, free: IntArray) -> float:
    """Return the change of -2 log evidence for values that must be whole multiples of a step.

    The multiple k has prior probability 2^-|k| / 3; the evidence is summed over the multiples.
    """
    steps, values = _whole_steps(explanation, free)
    is_whole = np.isfinite(steps)
    if not is_whole.any():
        return 0.0
    found, whole, others = marginal(sums, scatter), np.flatnonzero(is_whole), np.flatnonzero(~is_whole)
    at_any = replace(found, sigma=np.where(is_whole, _ANY, found.sigma)).values
    nearest = np.round((values + at_any)[whole] / steps[whole])
    logs = []
    for off in product(range(-_MOST_STEPS, _MOST_STEPS + 1), repeat=whole.size):
        multiple = nearest + off
        known = Known(others, found.sigma[others], whole, multiple * steps[whole] - values[whole])
        prior = float(np.sum(np.log(2.0) * np.abs(multiple) + np.log(3.0)))
        logs.append(-0.5 * found.of_columns(known).minus_two_log_evidence - prior)
    return float(-2.0 * np.logaddexp.reduce(logs) - found.minus_two_log_evidence)


def _whole_steps(explanation: Explanation, free: IntArray) -> tuple[FloatArray, FloatArray]:
    """Return the step of each free value (NaN for any number) and the values, both (p,) in prior sigmas."""
    steps = [
        (hypothesis.cause.whole_steps or np.nan) / parameter.prior_sigma
        for hypothesis in explanation.hypotheses
        for parameter in hypothesis.cause.parameters
    ]
    return np.array(steps, dtype=np.float64)[free], (explanation.vector() / explanation.prior_sigma)[free]


def reduced_chi_squared(found: Fit) -> float:
    """Return the mean square of the whitened residuals per degree of freedom: 1 where only noise is left."""
    return float(found.chi_squared / max(1, found.residual.size - found.at.free.size))


def is_physical(found: Fit, settings: Settings = DEFAULT) -> bool:
    """Return whether all values are above their minimum, within three standard errors, and of a usual size."""
    parameters, values, bench = found.explanation.parameters(), found.explanation.vector(), found.at.state.bench
    pairs = zip(parameters, values, strict=True)
    whole = np.array([value if each.in_bench is None else each.in_bench(bench) for each, value in pairs])
    minimum = np.array([parameter.minimum for parameter in parameters])
    sizes = np.array([parameter.role is Role.SIZE for parameter in parameters], dtype=bool)
    mean = np.array([parameter.prior_mean for parameter in parameters])
    usual = np.abs((values - mean)[sizes]) <= settings.max_prior_sigmas * found.explanation.prior_sigma[sizes]
    return bool(np.all(whole >= minimum - 3.0 * found.sigmas()) and np.all(usual))


def few_captures_factor(found: Fit, observations: Observations) -> float:
    """Return the factor by which to widen standard errors because few captures determine the motions' sizes.

    The factor is Student's t for the captures that the fit leaves free; 1 at run time, which has no motions.
    """
    count = len(np.unique(observations.group[observations.part != RUN_TIME]))
    if count == 0:
        return 1.0
    freedom = max(1, count - found.at.free.size // 3)
    return float(scipy.special.stdtrit(freedom, 0.841344746))
