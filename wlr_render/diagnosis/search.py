"""Forward selection of causes: fit each candidate on top of those found so far, keep the best, and check it.

Candidates are compared on a subsample of the readings first; those that come close are fitted again to all of them.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from wlr_render.diagnosis import evidence
from wlr_render.diagnosis.candidates import ScreenedHypothesis, best_fit, screen
from wlr_render.diagnosis.evidence import HeldOutImprovement, held_out_improvement, held_out_squares
from wlr_render.diagnosis.fit import Fit, fit
from wlr_render.diagnosis.noise import excess_over_noise
from wlr_render.diagnosis.prediction import Explanation, Hypothesis, Predictor
from wlr_render.diagnosis.settings import DEFAULT, Settings
from wlr_render.numerics.arrays import BoolArray

Progress = Callable[[str], None]

_NOTHING_MORE = "no other cause gains more than chance would"


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
            and evidence.p_value(share * each.gain / scale, each.parameters, len(self.hypotheses))
            < settings.max_p_value
        ][: settings.max_fits]
        self.progress(f"fitting {', '.join(sorted({each.hypothesis.cause.name for each in kept}))}")
        fits = [best_fit(self.subsample, at, each) for each in kept]
        coarse = self._ranked([found for found in fits if evidence.is_physical(found, settings)])
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
        chance = evidence.p_value(gained, max(added, 1), len(self.hypotheses))
        if chance > 0.5:
            return _NOTHING_MORE
        if chance > settings.max_p_value:
            return f"{name} comes next, but chance alone gains as much with a probability of {chance:.2g}"
        held_out = self.improvement(current, best.fit)
        if held_out.significance < settings.min_held_out_se:
            return f"{name} comes next, but held-out captures gain {held_out.significance:.1f} standard errors only"
        above = evidence.reduced_chi_squared(current) - 1.0
        share = (evidence.reduced_chi_squared(current) - best.reduced_chi_squared) / above if above > 0 else 1.0
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
            ratio = evidence.reduced_chi_squared(without_it) / evidence.reduced_chi_squared(with_it)
            if ratio > self.settings.max_idle_ratio:
                continue
            full = fit(self.full, without_it.explanation, self.used)
            if self._evidence(full) < self._evidence(found):
                found = full
        return found

    def _evidence(self, found: Fit) -> float:
        return evidence.minus_two_log_evidence(found, self.settings)

    def _ranked(self, fits: Sequence[Fit]) -> list[Candidate]:
        """Highest evidence first; a fit that lost its readings on the way has no evidence, and is no candidate."""
        candidates = [
            Candidate(each.explanation.hypotheses[-1], each, self._evidence(each), evidence.reduced_chi_squared(each))
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
