"""Screening of hypotheses: what each would gain on top of a fit, to first order, from the best of its starts."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from wlr_render.captures.session import SessionPlan
from wlr_render.diagnosis.cause import Cause, Role
from wlr_render.diagnosis.fit import Fit, choices, fit, off_prior, times_between_captures
from wlr_render.diagnosis.prediction import Explanation, Hypothesis
from wlr_render.diagnosis.scatter import Scatter, ScatterSums, best_scatter, cost, one_by_one
from wlr_render.diagnosis.weighed_readings import WeighedReadings
from wlr_render.numerics.arrays import FloatArray

HOPELESS = -2.0
"""Gain with the sizes of what is random as they are, below which other sizes do not help."""
_TIMES = 6  # tried at once
_ROUGHLY = 0.5  # chi-squared that a step must gain where fits are compared


@dataclass(frozen=True, eq=False)
class ScreenedHypothesis:
    """The gain of a hypothesis to first order.

    Attributes:
        hypothesis: which.
        start: its values from which a fit should set out.
        gain: by how much -2 log evidence would fall.
        parameters: how many numbers that takes.
        scatter: sizes of what is random with it.
    """

    hypothesis: Hypothesis
    start: FloatArray
    gain: float
    parameters: int
    scatter: Scatter


def hypotheses(causes: Mapping[str, Cause]) -> list[Hypothesis]:
    """Every cause in each of its ways."""
    return [Hypothesis(cause, variant) for cause in causes.values() for variant in cause.variants]


def screen(readings: WeighedReadings, current: Fit, hypothesis: Hypothesis) -> ScreenedHypothesis | None:
    """The gain of a hypothesis over a fit to the same readings; None where it changes nothing."""
    predictor, mean = readings.predictor, -off_prior(current.explanation)[current.at.free]
    base = cost(readings.sums(current.at.residual, current.at.jacobian), current.scatter, mean)
    # What a cause does to a few captures, those that seem to have moved do, too; and then say nothing of its moment.
    roles, at_rest = [parameter.role for parameter in hypothesis.cause.parameters], current.scatter.at_rest()
    scatters = [at_rest] if Role.TIME in roles or not current.scatter.moved.any() else [current.scatter, at_rest]

    def joined(start: FloatArray) -> tuple[int, ScatterSums, FloatArray]:
        explanation = current.explanation.plus(hypothesis, start)
        added = predictor.added(current.at.state, explanation)
        columns = np.concatenate([current.at.jacobian, added.jacobian], axis=-1)
        mean = -off_prior(explanation)[np.concatenate([current.at.free, added.free])]
        return added.free.size, readings.sums(current.at.residual, columns), mean

    def of(start: FloatArray) -> ScreenedHypothesis:
        added, sums, mean = joined(start)
        costs = [cost(sums, each, mean) for each in scatters]
        best = int(np.argmin(costs))
        return ScreenedHypothesis(hypothesis, start, base - costs[best] if added else 0.0, added, scatters[best])

    plan = readings.observations.session.plan
    best = max((of(start) for start in _starts(hypothesis.cause, plan)), key=lambda each: each.gain, default=None)
    if best is None or best.parameters == 0:
        return None
    if Role.TIME in roles:
        best = _with_better_time(of, best, roles.index(Role.TIME), times_between_captures(plan))
    if best.gain < HOPELESS and not (Role.TIME in roles and current.scatter.moved.any()):
        return best
    _, sums, mean = joined(best.start)
    scatter, least = best_scatter(sums, best.scatter, mean)
    scatter, least = one_by_one(sums, scatter, least, np.flatnonzero(current.scatter.moved), mean)
    least += 2.0 * float(np.log(choices(Explanation().plus(hypothesis), readings.observations)))
    return replace(best, gain=base - least, scatter=scatter)


def _with_better_time(
    of: Callable[[FloatArray], ScreenedHypothesis], best: ScreenedHypothesis, place: int, times: FloatArray
) -> ScreenedHypothesis:
    """Try the times around the best so far, ever closer, until its neighbours have been tried."""
    stride = max(1, len(times) // (2 * _TIMES))
    while stride >= 1:
        at = int(np.argmin(np.abs(times - best.start[place])))
        neighbours = {max(at - stride, 0), min(at + stride, len(times) - 1)} - {at}
        if not neighbours:
            break
        found = max((of(_with(best.start, place, float(times[n]))) for n in neighbours), key=lambda p: p.gain)
        stride = stride if found.gain > best.gain else stride // 2
        best = max(best, found, key=lambda each: each.gain)
    return best


def best_fit(readings: WeighedReadings, current: Fit, screened: ScreenedHypothesis) -> Fit | None:
    """Fit an explanation with one more cause from the start of its screened."""
    corrected = current.explanation.plus(screened.hypothesis, screened.start)
    return fit(readings, corrected, screened.scatter, near=current.at.state, settled=_ROUGHLY)


def _starts(cause: Cause, plan: SessionPlan) -> list[FloatArray]:
    """Null values with every start of the parameters that have several; none where all captures have one time."""
    starts = [cause.null()]
    for number, parameter in enumerate(cause.parameters):
        if parameter.role is Role.SIZE:
            continue
        values = _some(times_between_captures(plan)) if parameter.role is Role.TIME else np.array(parameter.starts)
        starts = [_with(start, number, float(value)) for start in starts for value in values]
    return starts


def _some(values: FloatArray) -> FloatArray:
    chosen = np.unique(np.linspace(0, len(values) - 1, min(len(values), _TIMES)).round().astype(int))
    return np.asarray(values[chosen])


def _with(values: FloatArray, number: int, value: float) -> FloatArray:
    changed = values.copy()
    changed[number] = value
    return changed
