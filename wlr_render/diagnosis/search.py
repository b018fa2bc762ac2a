"""Forward selection of causes: fit each candidate on top of those found so far, keep the best, and check it.

Candidates are compared on a subsample of the readings first: all by their gain to first order, the best by a fit from
their best start. Those that come close are fitted again to all readings.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from wlr_render.captures.session import SessionPlan
from wlr_render.diagnosis.cause import Cause, Role
from wlr_render.diagnosis.fit import (
    Fit,
    HeldOutImprovement,
    fit,
    held_out_improvement,
    held_out_squares,
    is_physical,
    minus_two_log_evidence,
    p_value,
    reduced_chi_squared,
)
from wlr_render.diagnosis.noise import excess_over_noise
from wlr_render.diagnosis.prediction import Explanation, Hypothesis, Linearisation, Predictor
from wlr_render.diagnosis.settings import DEFAULT, Settings
from wlr_render.numerics.arrays import BoolArray, FloatArray

Progress = Callable[[str], None]

_NOTHING_MORE = "no other cause gains more than chance would"
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


@dataclass(frozen=True, eq=False)
class Candidate:
    """A fitted candidate for one more cause.

    Attributes:
        hypothesis: which cause, acting how.
        fit: with it.
        minus_two_log_evidence: see `evidence`; lower is better.
        reduced_chi_squared: that it leaves.
        behind: by how much its -2 log evidence for the whole session exceeds the best one's.
        fitted_to_all: whether all readings were fitted, and not only the subsample.
    """

    hypothesis: Hypothesis
    fit: Fit
    minus_two_log_evidence: float
    reduced_chi_squared: float
    behind: float = 0.0
    fitted_to_all: bool = False


@dataclass(frozen=True, eq=False)
class CandidateRanking:
    """The candidates for one more cause.

    Attributes:
        current: the fit to which it would be added.
        subsample: the same fit to the subsample, on which hypotheses are compared.
        screened: the gain of each hypothesis on the subsample to first order; largest first.
        candidates: those that were fitted, best first, one per cause in the best of its variants.
    """

    current: Fit
    subsample: Fit
    screened: tuple[ScreenedHypothesis, ...]
    candidates: tuple[Candidate, ...]


@dataclass(frozen=True, eq=False)
class Selection:
    """The result of a selection.

    Attributes:
        fit: of all causes.
        first: the candidates for the first cause.
        reason: why no further cause was added.
    """

    fit: Fit
    first: CandidateRanking
    reason: str


@dataclass(frozen=True, eq=False)
class Search:
    """Inputs of a selection.

    Attributes:
        full: predictor of all readings.
        subsample: predictor of some, for the first comparison.
        used, subsample_used: masks of their readings that are not excluded.
        hypotheses: the candidates.
        progress: called with a sentence at each step.
        settings: thresholds.
    """

    full: Predictor
    subsample: Predictor
    used: BoolArray
    subsample_used: BoolArray
    hypotheses: Sequence[Hypothesis]
    progress: Progress = lambda _: None
    settings: Settings = DEFAULT

    def select(self) -> Selection:
        """Add causes while each is worth it; restart from runners-up where few causes do not reach the noise."""
        first = self.rank(fit(self.full, Explanation(), self.used))
        best = self._grown(first)
        if len(best.fit.explanation.hypotheses) > 2 or not self.is_at_noise(best.fit):
            for seed in self._seeds(first):
                self.progress(f"again from {seed.hypothesis.cause.name}")
                start = seed.fit if seed.fitted_to_all else fit(self.full, seed.fit.explanation, self.used)
                other = self._grown(self.rank(start))
                if self._evidence(other.fit) < self._evidence(best.fit):
                    best = replace(other, first=first)
        return best

    def _seeds(self, first: CandidateRanking) -> list[Candidate]:
        """Runners-up of the first place that are worth a restart."""
        settings, (best, *others) = self.settings, first.candidates or (None,)
        if best is None:
            return []
        limit = settings.restart_ratio * best.reduced_chi_squared
        return [other for other in others if other.reduced_chi_squared < limit][: settings.restarts]

    def _grown(self, start: CandidateRanking) -> Selection:
        """Add one cause after the other."""
        at, most = start, self.settings.max_causes
        while True:
            refusal = self._refusal(at)
            if refusal:
                return Selection(at.current, start, refusal)
            found = self._pruned(at.candidates[0].fit)
            if len(found.explanation.hypotheses) >= most:
                return Selection(found, start, f"{most} causes are the most that are searched for")
            at = self.rank(found)

    def rank(self, current: Fit) -> CandidateRanking:
        """Rank the causes that are not yet at work."""
        taken = set(current.explanation.names)
        at = fit(self.subsample, current.explanation, self.subsample_used, 0)
        screened = []
        for number, hypothesis in enumerate(self.hypotheses):
            if hypothesis.cause.name not in taken:
                self.progress(f"cause {len(taken) + 1}: {hypothesis.cause.name} ({number + 1}/{len(self.hypotheses)})")
                screened.append(screen(self.subsample, at, hypothesis))
        found = tuple(sorted((each for each in screened if each is not None), key=lambda each: -each.gain))
        return CandidateRanking(current, at, found, tuple(self._fitted(at, found)))

    def _fitted(self, at: Fit, screened: Sequence[ScreenedHypothesis]) -> list[Candidate]:
        """Fits of the hypotheses that are worth one, best first."""
        if not screened:
            return []
        settings, share = self.settings, float(self.used.sum() / self.subsample_used.sum())
        scale = max(1.0, (at.chi_squared - screened[0].gain) / (2 * self.subsample_used.sum()))
        kept = [
            each
            for each in screened
            if each.gain > settings.min_relative_gain * screened[0].gain
            and p_value(share * each.gain / scale, each.parameters, len(self.hypotheses)) < settings.max_p_value
        ][: settings.max_fits]
        self.progress(f"fitting {', '.join(sorted({each.hypothesis.cause.name for each in kept}))}")
        fits = [best_fit(self.subsample, at, each) for each in kept]
        coarse = self._ranked([found for found in fits if is_physical(found, settings)])
        behind = [share * (each.minus_two_log_evidence - coarse[0].minus_two_log_evidence) for each in coarse]
        close = [each for each, by in zip(coarse, behind, strict=True) if by < settings.close_evidence]
        contenders = close[: settings.max_contenders]
        final = self._ranked([fit(self.full, each.fit.explanation, self.used) for each in contenders])
        if not final:
            return []
        best = final[0].minus_two_log_evidence
        names = {each.hypothesis.cause.name for each in final}
        rest = [replace(each, behind=by) for each, by in zip(coarse, behind, strict=True)]
        return [
            replace(each, behind=each.minus_two_log_evidence - best, fitted_to_all=True)
            for each in _best_of_each(final)
        ] + [each for each in _best_of_each(rest) if each.hypothesis.cause.name not in names]

    def improvement(self, before: Fit, after: Fit) -> HeldOutImprovement:
        """By how much a fit predicts held-out captures better than another."""
        observations = self.full.observations
        squares = [held_out_squares(each, observations.group, len(observations.captures)) for each in (before, after)]
        return held_out_improvement(*squares)

    def is_at_noise(self, found: Fit) -> bool:
        """Whether a fit leaves no more than noise in any part of the session."""
        excesses = excess_over_noise(self.full.observations, found.residual, found.used, self.settings)
        return not any(excess.is_significant for excess in excesses.values())

    def _refusal(self, at: CandidateRanking) -> str:
        """Why the best candidate is not worth adding; empty where it is."""
        if not at.candidates:
            return _NOTHING_MORE
        settings, current, best = self.settings, at.current, at.candidates[0]
        name = best.hypothesis.cause.name
        added = best.fit.at.free.size - current.at.free.size
        gained = (current.chi_squared - best.fit.chi_squared) / max(1.0, best.reduced_chi_squared)
        chance = p_value(gained, max(added, 1), len(self.hypotheses))
        if chance > 0.5:
            return _NOTHING_MORE
        if chance > settings.max_p_value:
            return f"{name} comes next, but chance alone gains as much with a probability of {chance:.2g}"
        held_out = self.improvement(current, best.fit)
        if held_out.significance < settings.min_held_out_se:
            return f"{name} comes next, but held-out captures gain {held_out.significance:.1f} standard errors only"
        above = reduced_chi_squared(current) - 1.0
        share = (reduced_chi_squared(current) - best.reduced_chi_squared) / above if above > 0 else 1.0
        if share < settings.min_share_explained and not self.is_at_noise(best.fit):
            return (
                f"{name} comes next, but explains only {100 * share:.0f} % of the excess over the noise, and more than "
                "noise would be left"
            )
        return ""

    def _pruned(self, found: Fit) -> Fit:
        """Leave out every cause that a later one has made idle."""
        for place in reversed(range(len(found.explanation.hypotheses) - 1)):
            rest = found.explanation.without(place)
            with_it, without_it = (fit(self.subsample, each, self.subsample_used) for each in (found.explanation, rest))
            ratio = reduced_chi_squared(without_it) / reduced_chi_squared(with_it)
            if ratio > self.settings.max_idle_ratio:
                continue
            full = fit(self.full, without_it.explanation, self.used)
            if self._evidence(full) < self._evidence(found):
                found = full
        return found

    def _evidence(self, found: Fit) -> float:
        return minus_two_log_evidence(found, self.settings)

    def _ranked(self, fits: Sequence[Fit]) -> list[Candidate]:
        """Highest evidence first; a fit that lost its readings on the way has no evidence, and is no candidate."""
        candidates = [
            Candidate(each.explanation.hypotheses[-1], each, self._evidence(each), reduced_chi_squared(each))
            for each in fits
        ]
        finite = (each for each in candidates if np.isfinite(each.minus_two_log_evidence))
        return sorted(finite, key=lambda each: each.minus_two_log_evidence)


def _best_of_each(candidates: Sequence[Candidate]) -> list[Candidate]:
    """The first candidate of each cause."""
    firsts: dict[str, Candidate] = {}
    for candidate in candidates:
        firsts.setdefault(candidate.hypothesis.cause.name, candidate)
    return list(firsts.values())


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
    parts = [part for part in plan.parts if part is not None]
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
