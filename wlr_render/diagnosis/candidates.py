"""Candidates for one more cause: the gain of each to first order, and its fit from the best start."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from wlr_render.captures.session import SessionPlan
from wlr_render.diagnosis.cause import Cause, Role
from wlr_render.diagnosis.fit import Fit, fit
from wlr_render.diagnosis.prediction import Hypothesis, Linearisation, Predictor
from wlr_render.numerics.arrays import FloatArray

_TIMES = 6  # tried at once
_EDGE = 0.05  # of all captures must lie on either side of a time: fewer are captures that moved


@dataclass(frozen=True, eq=False)
class ScreenedHypothesis:
    """The gain of a hypothesis to first order.

    Attributes:
        hypothesis: which.
        start: its values from which a fit should set out.
        gain: by how much chi-squared would fall.
        parameters: how many numbers that takes.
    """

    hypothesis: Hypothesis
    start: FloatArray
    gain: float
    parameters: int


def hypotheses(causes: Mapping[str, Cause]) -> list[Hypothesis]:
    """Every cause in each of its ways."""
    return [Hypothesis(cause, variant) for cause in causes.values() for variant in cause.variants]


def screen(predictor: Predictor, current: Fit, hypothesis: Hypothesis) -> ScreenedHypothesis | None:
    """The gain of a hypothesis over a fit by the same predictor; None where it changes nothing."""

    def of(start: FloatArray) -> ScreenedHypothesis:
        at = predictor.added(current.at.state, current.explanation.plus(hypothesis, start))
        return ScreenedHypothesis(hypothesis, start, _gain(current, at) if at.free.size else 0.0, at.free.size)

    plan, roles = predictor.observations.session.plan, [parameter.role for parameter in hypothesis.cause.parameters]
    best = max((of(start) for start in _starts(hypothesis.cause, plan)), key=lambda each: each.gain, default=None)
    if best is None or best.parameters == 0:
        return None
    if Role.TIME not in roles:
        return best
    return _with_better_time(of, best, roles.index(Role.TIME), times_between_captures(plan))


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


def _gain(current: Fit, added: Linearisation) -> float:
    """Fall of chi-squared when the added columns join those of the current fit."""
    used = current.used & np.isfinite(added.jacobian).all(axis=(1, 2))
    columns = np.concatenate([current.at.jacobian[used], added.jacobian[used]], axis=-1)
    columns = columns.reshape(2 * int(used.sum()), columns.shape[-1])
    residual = current.residual[used].ravel()
    information, gradient = columns.T @ columns, columns.T @ residual
    scale = np.sqrt(np.diag(information)).clip(1e-300)
    information = information / scale / scale[:, None] + 1e-10 * np.eye(len(scale))
    gradient, old = gradient / scale, current.at.free.size
    total = float(gradient @ np.linalg.solve(information, gradient))
    already = float(gradient[:old] @ np.linalg.solve(information[:old, :old], gradient[:old])) if old else 0.0
    return total - already


def best_fit(predictor: Predictor, current: Fit, prospect: ScreenedHypothesis) -> Fit:
    """Fit an explanation with one more cause from the start of its prospect."""
    corrected = current.explanation.plus(prospect.hypothesis, prospect.start)
    return fit(predictor, corrected, current.used, near=current.at.state)


def _starts(cause: Cause, plan: SessionPlan) -> list[FloatArray]:
    """Null values with every start of the parameters that have several; none where all captures have one time."""
    starts = [cause.null()]
    for number, parameter in enumerate(cause.parameters):
        if parameter.role is Role.SIZE:
            continue
        values = _some(times_between_captures(plan)) if parameter.role is Role.TIME else np.array(parameter.starts)
        starts = [_with(start, number, float(value)) for start in starts for value in values]
    return starts


def times_between_captures(plan: SessionPlan) -> FloatArray:
    """Times in the middle between captures, ascending, without those near either end."""
    parts = [part for part in (plan.display, plan.see_through, plan.run_time) if part is not None]
    times = np.unique(np.concatenate([part.time_s for part in parts]))
    edge = int(np.ceil(_EDGE * len(times)))
    return np.asarray(0.5 * (times[1:] + times[:-1]))[edge : len(times) - 1 - edge]


def _some(values: FloatArray) -> FloatArray:
    chosen = np.unique(np.linspace(0, len(values) - 1, min(len(values), _TIMES)).round().astype(int))
    return np.asarray(values[chosen])


def _with(values: FloatArray, number: int, value: float) -> FloatArray:
    changed = values.copy()
    changed[number] = value
    return changed
