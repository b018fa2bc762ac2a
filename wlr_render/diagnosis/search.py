"""Forward selection of causes: fit each candidate on top of those found so far, keep the best, and check it.

Candidates are compared on a thinned session first; those that come close are fitted again on all of it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from wlr_render.diagnosis import evidence
from wlr_render.diagnosis.extension import Extension, Hypothesis, Predictor
from wlr_render.diagnosis.fit import Fit, fit
from wlr_render.diagnosis.held_out import HeldOutGain, held_out_gain, held_out_squares
from wlr_render.diagnosis.hypotheses import Prospect, best_fit, prospect
from wlr_render.diagnosis.noise import excess_over_noise
from wlr_render.numerics.arrays import BoolArray

Progress = Callable[[str], None]

_PROMISE = 0.3  # of the best prospect's gain: who promises less is not fitted
_FITTED = 10  # prospects at most
_SEEDS = 2
_SEED = 3.0  # times the best candidate's misfit, up to which a runner-up is worth starting from
_CONTENDERS = 5
_CLOSE = 40.0  # of the cost, scaled to the whole session: who is further behind is not fitted again
_CHANCE = 1e-3
_SIGNIFICANCE = 2.0  # standard errors of the held-out difference
_SHARE = 0.3  # of what is above the noise: a cause must take away so much, unless it leads down to the noise
_IDLE = 1.2  # misfit over the misfit with a cause, up to which it may be idle
_NOTHING_MORE = "no other cause gains more than chance would"


@dataclass(frozen=True, eq=False)
class Candidate:
    """One cause more.

    Attributes:
        hypothesis: which, acting how.
        fit: with it.
        cost: see `evidence.cost`; lower is better.
        misfit: mean square residual over the noise's that it leaves.
        behind: by how much its cost for the whole session exceeds the best one's.
        whole: whether all readings were fitted, and not only those that are screened.
    """

    hypothesis: Hypothesis
    fit: Fit
    cost: float
    misfit: float
    behind: float = 0.0
    whole: bool = False


@dataclass(frozen=True, eq=False)
class Round:
    """The candidates for one more cause.

    Attributes:
        current: the fit to which it would be added.
        screened: the same fit to the readings on which prospects are compared.
        prospects: what each hypothesis promises to first order, on the readings screened; most first.
        candidates: those that were fitted, best first, one per cause in the best of its ways.
    """

    current: Fit
    screened: Fit
    prospects: tuple[Prospect, ...]
    candidates: tuple[Candidate, ...]


@dataclass(frozen=True, eq=False)
class Selection:
    """What the selection found.

    Attributes:
        fit: the result.
        first: the candidates for the first cause.
        reason: why no more was taken than it has.
    """

    fit: Fit
    first: Round
    reason: str


@dataclass(frozen=True, eq=False)
class Search:
    """What a selection works with.

    Attributes:
        full: predictor of all readings.
        thin: predictor of some, for the first comparison.
        used, thin_used: which of their readings count.
        hypotheses: the candidates.
        progress: told what is being done.
    """

    full: Predictor
    thin: Predictor
    used: BoolArray
    thin_used: BoolArray
    hypotheses: Sequence[Hypothesis]
    progress: Progress

    def select(self, most: int) -> Selection:
        """Add causes, up to `most`, while each is worth it.

        Where a few causes do not lead down to the noise, the selection is tried again from the runners-up of the first
        round: of two causes at work, the one that alone explains most may be neither.
        """
        first = self.round(fit(self.full, Extension(), self.used))
        best = self._grown(first, most)
        if len(best.fit.extension.hypotheses) > 2 or not self._at_noise(best.fit):
            for seed in [c for c in first.candidates[1:] if c.misfit < _SEED * first.candidates[0].misfit][:_SEEDS]:
                self.progress(f"again from {seed.hypothesis.cause.name}")
                start = seed.fit if seed.whole else fit(self.full, seed.fit.extension, self.used)
                other = self._grown(self.round(start), most)
                if evidence.cost(other.fit) < evidence.cost(best.fit):
                    best = replace(other, first=first)
        return best

    def _grown(self, start: Round, most: int) -> Selection:
        """Add causes, round by round."""
        at = start
        while True:
            taken, reason = self._verdict(at)
            if not taken:
                return Selection(at.current, start, reason)
            found = self._pruned(at.candidates[0].fit)
            if len(found.extension.hypotheses) >= most:
                return Selection(found, start, f"{most} causes are the most that are looked for")
            at = self.round(found)

    def round(self, current: Fit) -> Round:
        """Causes not yet at work that promise anything, best first."""
        taken = set(current.extension.names)
        at = fit(self.thin, current.extension, self.thin_used, 0)
        share = float(self.used.sum() / self.thin_used.sum())
        prospects = []
        for number, hypothesis in enumerate(self.hypotheses):
            if hypothesis.cause.name not in taken:
                self.progress(f"cause {len(taken) + 1}: {hypothesis.cause.name} ({number + 1}/{len(self.hypotheses)})")
                prospects.append(prospect(self.thin, at, hypothesis))
        found = tuple(sorted((p for p in prospects if p is not None), key=lambda p: -p.gain))
        return Round(current, at, found, tuple(self._fitted(at, found, share)))

    def _fitted(self, at: Fit, prospects: Sequence[Prospect], share: float) -> list[Candidate]:
        """Fits of the prospects that are worth one, best first."""
        if not prospects:
            return []
        scale = max(1.0, (at.chi_squared - prospects[0].gain) / (2 * self.thin_used.sum()))
        kept = [
            p
            for p in prospects
            if p.gain > _PROMISE * prospects[0].gain
            and evidence.chance(share * p.gain / scale, p.parameters, len(self.hypotheses)) < _CHANCE
        ][:_FITTED]
        self.progress(f"fitting {', '.join(sorted({p.hypothesis.cause.name for p in kept}))}")
        fits = [best_fit(self.thin, at, p) for p in kept]
        screened = _ranked([found for found in fits if evidence.physical(found)])
        close = [c for c in screened if share * (c.cost - screened[0].cost) < _CLOSE][:_CONTENDERS]
        final = _ranked([fit(self.full, candidate.fit.extension, self.used) for candidate in close])
        if not final:
            return []
        names = {candidate.hypothesis.cause.name for candidate in final}
        rest = [c for c in _best_of_each(screened) if c.hypothesis.cause.name not in names]
        return [replace(c, behind=c.cost - final[0].cost, whole=True) for c in _best_of_each(final)] + [
            replace(c, behind=share * (c.cost - screened[0].cost)) for c in rest
        ]

    def gain(self, before: Fit, after: Fit) -> HeldOutGain:
        """By how much a fit predicts held-out captures better than another."""
        observations = self.full.observations
        squares = [held_out_squares(each, observations.group, len(observations.captures)) for each in (before, after)]
        return held_out_gain(*squares)

    def _at_noise(self, found: Fit) -> bool:
        """Whether no part of the session is left with more than noise."""
        excesses = excess_over_noise(self.full.observations, found.residual, found.used)
        return not any(excess.is_significant for excess in excesses.values())

    def _verdict(self, at: Round) -> tuple[bool, str]:
        """Whether the best candidate is worth adding, and why not."""
        if not at.candidates:
            return False, _NOTHING_MORE
        current, best = at.current, at.candidates[0]
        name = best.hypothesis.cause.name
        added = best.fit.at.free.size - current.at.free.size
        gained = (current.chi_squared - best.fit.chi_squared) / max(1.0, best.misfit)
        chance = evidence.chance(gained, max(added, 1), len(self.hypotheses))
        if chance > 0.5:
            return False, _NOTHING_MORE
        if chance > _CHANCE:
            return False, f"{name} comes next, but chance alone gains as much with a probability of {chance:.2g}"
        gain = self.gain(current, best.fit)
        if gain.significance < _SIGNIFICANCE:
            return False, f"{name} comes next, but held-out captures gain {gain.significance:.1f} standard errors only"
        above = evidence.misfit(current) - 1.0
        share = (evidence.misfit(current) - best.misfit) / above if above > 0 else 1.0
        if share < _SHARE and not self._at_noise(best.fit):
            return False, (
                f"{name} comes next, but takes away only {100 * share:.0f} % of what is above the noise, and does not "
                "lead down to it"
            )
        return True, ""

    def _pruned(self, found: Fit) -> Fit:
        """Leave out every cause that a later one has made idle."""
        for place in reversed(range(len(found.extension.hypotheses) - 1)):
            rest = found.extension.without(place)
            with_it, without_it = (fit(self.thin, each, self.thin_used) for each in (found.extension, rest))
            if evidence.misfit(without_it) > _IDLE * evidence.misfit(with_it):
                continue
            full = fit(self.full, without_it.extension, self.used)
            if evidence.cost(full) < evidence.cost(found):
                found = full
        return found


def _ranked(fits: Sequence[Fit]) -> list[Candidate]:
    """Lowest cost first; a fit that lost its readings on the way has no cost, and is no candidate."""
    candidates = [
        Candidate(each.extension.hypotheses[-1], each, evidence.cost(each), evidence.misfit(each)) for each in fits
    ]
    return sorted((c for c in candidates if np.isfinite(c.cost)), key=lambda candidate: candidate.cost)


def _best_of_each(candidates: Sequence[Candidate]) -> list[Candidate]:
    """The first of each cause."""
    firsts: dict[str, Candidate] = {}
    for candidate in candidates:
        firsts.setdefault(candidate.hypothesis.cause.name, candidate)
    return list(firsts.values())
