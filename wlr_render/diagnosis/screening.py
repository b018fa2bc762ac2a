"""Screening of hypotheses: the gain of each in addition to a fit, to first order, from its best start."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from wlr_render.captures.session import SessionPlan
from wlr_render.diagnosis.cause import Cause, Role
from wlr_render.diagnosis.fit import Fit, choices, fit, times_between_captures
from wlr_render.diagnosis.prediction import Explanation, Hypothesis
from wlr_render.diagnosis.weighed_readings import WeighedReadings
from wlr_render.numerics.arrays import FloatArray, IntArray
from wlr_render.numerics.scatter import Scatter, ScatterSums, cost
from wlr_render.numerics.scatter_search import best_scatter, one_by_one

HOPELESS = -2.0
"""Gain with unchanged sizes of noise and motions below which other sizes do not help."""
_TIMES = 6  # number of times tried at once
_CLOSELY = 12  # number of hypotheses, by gain, for which sizes of noise and motions are searched


@dataclass(frozen=True, eq=False)
class ScreenedHypothesis:
    """The gain of a hypothesis to first order.

    Attributes:
        hypothesis: the cause and its variant.
        start: start values for a fit.
        gain: fall of -2 log evidence.
        parameters: number of free parameters.
        scatter: sizes of noise and motions with the hypothesis.
        sums: sums over the columns of the fit and then of the hypothesis.
        columns: its columns in the signatures; None if it has no signature.
    """

    hypothesis: Hypothesis
    start: FloatArray
    gain: float
    parameters: int
    scatter: Scatter
    sums: ScatterSums
    columns: IntArray | None = None


def hypotheses(causes: Mapping[str, Cause]) -> list[Hypothesis]:
    """Return every cause in each of its variants."""
    return [Hypothesis(cause, variant) for cause in causes.values() for variant in cause.variants]


@dataclass(frozen=True, eq=False)
class Signatures:
    """Effects of hypotheses on readings, to first order about the nominal bench, from each of their starts.

    To first order the effect of a hypothesis does not depend on the other causes.

    Attributes:
        readings: the readings.
        fixed: sums over all columns: first of the hypotheses, then of the fields.
        of_hypothesis: starts of each hypothesis, each with its free parameters and their columns.
    """

    readings: WeighedReadings
    fixed: ScatterSums
    of_hypothesis: dict[tuple[str, str], list[tuple[FloatArray, IntArray, IntArray]]]

    @classmethod
    def of(
        cls,
        readings: WeighedReadings,
        hypotheses: Sequence[Hypothesis],
        fields: Sequence[FloatArray] = (),
        progress: Callable[[str], None] = lambda _: None,
    ) -> "Signatures":
        """Simulate the effect of each hypothesis on the readings.

        Args:
            readings: the readings.
            hypotheses: hypotheses to screen.
            fields: (n, 2, c) columns of fields.
            progress: called with a sentence at each hypothesis.
        """
        predictor, plan = readings.predictor, readings.observations.session.plan
        columns, first = [np.zeros((len(readings.observations), 2, 0))], 0
        of_hypothesis = {}
        for number, hypothesis in enumerate(hypotheses):
            progress(f"signature of {hypothesis.cause.name} ({number + 1}/{len(hypotheses)})")
            starts = []
            for start in _starts(hypothesis.cause, plan):
                at = predictor.signature(hypothesis, start)
                columns.append(at.jacobian)
                starts.append((start, at.free, first + np.arange(at.free.size)))
                first += at.free.size
            of_hypothesis[hypothesis.cause.name, hypothesis.variant] = starts
        return cls(readings, readings.fixed(np.concatenate([*columns, *fields], axis=2)), of_hypothesis)


def screen(
    signatures: Signatures, current: Fit, hypotheses: Sequence[Hypothesis], sums: ScatterSums | None = None
) -> list[ScreenedHypothesis]:
    """Return the gain of each effective hypothesis over a fit, from its best start; largest first.

    Args:
        signatures: signatures of the hypotheses on the readings of the fit.
        current: the fit.
        hypotheses: hypotheses to screen.
        sums: sums over the signatures' columns and then the fit's, if already known.
    """
    if sums is None:
        sums = signatures.readings.sums_at(current.at, signatures.fixed)
    screening = _Screening(signatures, current, sums)
    found = [screened for each in hypotheses if (screened := screening.of(each)) is not None]
    found.sort(key=lambda each: -each.gain)
    return sorted(
        [*(screening.with_own_scatter(each) for each in found[:_CLOSELY]), *found[_CLOSELY:]],
        key=lambda each: -each.gain,
    )


@dataclass(frozen=True, eq=False)
class _Screening:
    """Shared state for screening hypotheses in addition to a fit."""

    signatures: Signatures
    current: Fit
    sums: ScatterSums

    def of(self, hypothesis: Hypothesis) -> ScreenedHypothesis | None:
        """Return the gain of a hypothesis with noise and motions unchanged, or without moved captures."""
        screened = [
            self._gain(hypothesis, start, free, self.sums.of_columns(np.r_[self._causes, columns]), columns)
            for start, free, columns in self.signatures.of_hypothesis[hypothesis.cause.name, hypothesis.variant]
        ]
        best = max(screened, key=lambda each: each.gain, default=None)
        if best is None or best.parameters == 0:
            return None
        roles = [parameter.role for parameter in hypothesis.cause.parameters]
        if Role.TIME in roles:
            return self._with_better_time(best, roles.index(Role.TIME))
        return best

    def _with_better_time(self, best: ScreenedHypothesis, place: int) -> ScreenedHypothesis:
        """Try times around the best so far at decreasing distances, down to its direct neighbours."""
        times = times_between_captures(self.signatures.readings.observations.session.plan)
        stride = max(1, len(times) // (2 * _TIMES))
        while stride >= 1:
            at = int(np.argmin(np.abs(times - best.start[place])))
            neighbours = {max(at - stride, 0), min(at + stride, len(times) - 1)} - {at}
            if not neighbours:
                break
            starts = (_with(best.start, place, float(times[n])) for n in neighbours)
            found = max((self._simulated(best.hypothesis, each) for each in starts), key=lambda each: each.gain)
            stride = stride if found.gain > best.gain else stride // 2
            best = max(best, found, key=lambda each: each.gain)
        return best

    def with_own_scatter(self, screened: ScreenedHypothesis) -> ScreenedHypothesis:
        """Return the hypothesis with the best sizes of noise and motions for it."""
        hypothesis, moved = screened.hypothesis, self.current.scatter.moved
        is_timed = any(parameter.role is Role.TIME for parameter in hypothesis.cause.parameters)
        if screened.gain < HOPELESS and not (is_timed and moved.any()):
            return screened
        scatter, least = best_scatter(screened.sums, screened.scatter)
        scatter, least = one_by_one(screened.sums, scatter, least, np.flatnonzero(moved))
        least += 2.0 * float(np.log(choices(Explanation().plus(hypothesis), self.signatures.readings.observations)))
        return replace(screened, gain=self._base - least, scatter=scatter)

    @cached_property
    def _causes(self) -> IntArray:
        return np.asarray(len(self.signatures.fixed.mean) + np.arange(self.current.at.free.size))

    @cached_property
    def _base(self) -> float:
        return cost(self.sums.of_columns(self._causes), self.current.scatter)

    def _simulated(self, hypothesis: Hypothesis, start: FloatArray) -> ScreenedHypothesis:
        """Return the gain from a start that has no signature yet."""
        readings = self.signatures.readings
        at = readings.predictor.signature(hypothesis, start)
        columns = np.concatenate([self.current.at.jacobian, at.jacobian], axis=-1)
        return self._gain(hypothesis, start, at.free, readings.sums(self.current.at.residual, columns))

    def _gain(
        self,
        hypothesis: Hypothesis,
        start: FloatArray,
        free: IntArray,
        sums: ScatterSums,
        columns: IntArray | None = None,
    ) -> ScreenedHypothesis:
        explanation = self.current.explanation.plus(hypothesis, start)
        place = len(self.current.explanation.vector()) + free
        mean = -explanation.off_prior[np.concatenate([self.current.at.free, place])]
        sums = sums.of_columns(np.arange(len(mean)), mean)
        # Captures that seem to have moved can imitate a cause that acts on a few captures, and hide its start time.
        is_timed = any(parameter.role is Role.TIME for parameter in hypothesis.cause.parameters)
        at_rest, scatter = self.current.scatter.at_rest(), self.current.scatter
        scatters = [at_rest] if is_timed or not scatter.moved.any() else [scatter, at_rest]
        costs = [cost(sums, each) for each in scatters]
        best = int(np.argmin(costs))
        gain = self._base - costs[best] if free.size else 0.0
        return ScreenedHypothesis(hypothesis, start, gain, free.size, scatters[best], sums, columns)


def best_fit(readings: WeighedReadings, current: Fit, screened: ScreenedHypothesis) -> Fit | None:
    """Fit an explanation with one more cause, roughly, from the screened start."""
    corrected = current.explanation.plus(screened.hypothesis, screened.start)
    at = readings.predictor.linearised(corrected, current.at.state)
    return fit(readings, corrected, screened.scatter, at=at, roughly=True)


def _starts(cause: Cause, plan: SessionPlan) -> list[FloatArray]:
    """Return the null values combined with every start of SHAPE and TIME parameters; empty without times to try."""
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
