"""Forward selection of causes: fit each candidate on top of those found so far, keep the best, and check it.

Candidates are compared on a thinned session first; those that come close are fitted again on all of it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wlr_render.diagnosis import evidence
from wlr_render.diagnosis.extension import Extension, Hypothesis, Predictor
from wlr_render.diagnosis.fit import Fit, fit
from wlr_render.diagnosis.held_out import HeldOutGain, held_out_gain, held_out_squares
from wlr_render.diagnosis.hypotheses import best_fit, prospect

BoolArray = NDArray[np.bool_]
Progress = Callable[[str], None]

_PROMISE = 0.3  # of the best prospect's gain: who promises less is not fitted
_FITTED = 10  # prospects at most
_SEEDS = 3
_CONTENDERS = 5
_CLOSE = 40.0  # of the cost, scaled to the whole session: who is further behind is not fitted again
_CHANCE = 1e-3
_SIGNIFICANCE = 3.0  # standard errors of the held-out difference
_SHARE = 0.3  # of what is above the noise: a cause must take away so much, unless it leads down to the noise
_AT_NOISE = 1.1  # misfit up to which residuals count as noise


@dataclass(frozen=True, eq=False)
class Candidate:
    """One cause more.

    Attributes:
        hypothesis: which, acting how.
        fit: with it.
        cost: see `evidence.cost`; lower is better.
        misfit: mean square residual over the noise's that it leaves.
    """

    hypothesis: Hypothesis
    fit: Fit
    cost: float
    misfit: float


@dataclass(frozen=True, eq=False)
class Step:
    """One round of the selection.

    Attributes:
        candidates: best first; one per cause, in the best of its ways.
        gain: of the best one on held-out captures.
        accepted: whether it was taken.
        reason: why, or why not, in one sentence.
    """

    candidates: tuple[Candidate, ...]
    gain: HeldOutGain
    accepted: bool
    reason: str


@dataclass(frozen=True, eq=False)
class Selection:
    """What the selection found.

    Attributes:
        steps: its rounds.
        fits: of no cause, one cause, and so on; the last one is the result.
    """

    steps: tuple[Step, ...]
    fits: tuple[Fit, ...]

    @property
    def fit(self) -> Fit:
        """The final fit."""
        return self.fits[-1]


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

        Where one cause is not enough, the selection is tried again from the runners-up of the first round: of two
        causes at work, the one that alone explains most may be neither.
        """
        best = self._grown(fit(self.full, Extension(), self.used), most)
        first = best.steps[0].candidates if best.steps else ()
        if len(best.fits) > 2 or evidence.misfit(best.fit) > _AT_NOISE:
            for seed in [c for c in first[1:] if c.fit.used.size == self.used.size][:_SEEDS]:
                self.progress(f"again from {seed.hypothesis.cause.name}")
                other = self._grown(seed.fit, most)
                other = Selection((best.steps[0], *other.steps), (best.fits[0], *other.fits))
                scale = min(evidence.misfit(other.fit), evidence.misfit(best.fit))
                if evidence.cost(other.fit, scale) < evidence.cost(best.fit, scale):
                    best = other
        return best

    def _grown(self, start: Fit, most: int) -> Selection:
        """Add causes to a fit, round by round."""
        fits, steps = [start], list[Step]()
        while len(fits[-1].extension.hypotheses) < most:
            step = self._round(fits[-1])
            if step is None:
                break
            steps.append(step)
            if not step.accepted:
                break
            fits.append(self._pruned(step.candidates[0].fit))
        return Selection(tuple(steps), tuple(fits))

    def _round(self, current: Fit) -> Step | None:
        candidates = self._candidates(current)
        if not candidates:
            return None
        best = candidates[0]
        gain = self._held_out(current, best.fit)
        accepted, reason = self._verdict(current, best, gain)
        return Step(tuple(candidates), gain, accepted, reason)

    def _candidates(self, current: Fit) -> list[Candidate]:
        """Causes not yet at work that promise anything, best first."""
        taken = set(current.extension.names)
        at = fit(self.thin, current.extension, self.thin_used, 0)
        share = float(self.used.sum() / self.thin_used.sum())
        prospects = []
        for number, hypothesis in enumerate(self.hypotheses):
            if hypothesis.cause.name not in taken:
                self.progress(f"cause {len(taken) + 1}: {hypothesis.cause.name} ({number + 1}/{len(self.hypotheses)})")
                prospects.append(prospect(self.thin, at, hypothesis))
        promising = sorted((p for p in prospects if p is not None), key=lambda p: -p.gain)
        scale = max(1.0, (at.chi_squared - promising[0].gain) / (2 * self.thin_used.sum())) if promising else 1.0
        kept = [
            p
            for p in promising
            if p.gain > _PROMISE * promising[0].gain
            and evidence.chance(share * p.gain / scale, p.parameters, len(self.hypotheses)) < _CHANCE
        ][:_FITTED]
        self.progress(f"cause {len(taken) + 1}: fitting {', '.join(sorted({p.hypothesis.cause.name for p in kept}))}")
        fits = [best_fit(self.thin, current.extension, p, self.thin_used) for p in kept]
        screened = self._ranked([found for found in fits if evidence.physical(found)])
        close = [c for c in screened if share * (c.cost - screened[0].cost) < _CLOSE][:_CONTENDERS]
        final = self._ranked([fit(self.full, candidate.fit.extension, self.used) for candidate in close])
        names = {candidate.hypothesis.cause.name for candidate in final}
        return _best_of_each(final) + [c for c in _best_of_each(screened) if c.hypothesis.cause.name not in names]

    def _ranked(self, fits: Sequence[Fit]) -> list[Candidate]:
        if not fits:
            return []
        scale = min(evidence.misfit(each) for each in fits)
        candidates = [
            Candidate(each.extension.hypotheses[-1], each, evidence.cost(each, scale), evidence.misfit(each))
            for each in fits
        ]
        return sorted(candidates, key=lambda candidate: candidate.cost)

    def _held_out(self, before: Fit, after: Fit) -> HeldOutGain:
        observations = self.full.observations
        squares = [held_out_squares(each, observations.group, len(observations.captures)) for each in (before, after)]
        return held_out_gain(*squares)

    def _verdict(self, current: Fit, best: Candidate, gain: HeldOutGain) -> tuple[bool, str]:
        added = best.fit.at.free.size - current.at.free.size
        gained = (current.chi_squared - best.fit.chi_squared) / max(1.0, best.misfit)
        chance = evidence.chance(gained, max(added, 1), len(self.hypotheses))
        if chance > _CHANCE:
            return False, f"chance alone gains as much with a probability of {chance:.2g}"
        if gain.significance < _SIGNIFICANCE:
            return False, f"held-out captures gain {gain.significance:.1f} standard errors only"
        above = evidence.misfit(current) - 1.0
        share = (evidence.misfit(current) - best.misfit) / above if above > 0 else 1.0
        if best.misfit > _AT_NOISE and share < _SHARE:
            return False, f"it takes away {100 * share:.0f} % of what is above the noise, and leaves the rest"
        return True, f"held-out captures gain {gain.significance:.0f} standard errors"

    def _pruned(self, found: Fit) -> Fit:
        """Leave out every cause that a later one has made idle."""
        for place in reversed(range(len(found.extension.hypotheses) - 1)):
            rest = fit(self.full, found.extension.without(place), self.used)
            scale = min(evidence.misfit(rest), evidence.misfit(found))
            if evidence.cost(rest, scale) < evidence.cost(found, scale):
                found = rest
        return found


def _best_of_each(candidates: Sequence[Candidate]) -> list[Candidate]:
    """The first of each cause."""
    firsts: dict[str, Candidate] = {}
    for candidate in candidates:
        firsts.setdefault(candidate.hypothesis.cause.name, candidate)
    return list(firsts.values())
