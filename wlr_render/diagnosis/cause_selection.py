"""Forward selection of causes by evidence: add the best candidate while the odds favour it.

Candidates are first compared on a subsample of the readings: all to first order, then the best by a fit from their
best start. Close candidates are fitted again to all readings. Each candidate has its own sizes of noise and motions.
Where a field at a station explains far more than all causes together, no cause is fitted alone: effects are located
first, then causes are fitted together with these effects.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from wlr_render.diagnosis.field_contest import FieldContest
from wlr_render.diagnosis.field_terms import ELSEWHERE, LocatedEffect, StationField
from wlr_render.diagnosis.fit import (
    Fit,
    fit,
    is_physical,
)
from wlr_render.diagnosis.held_out import HeldOutImprovement, held_out_improvement, held_out_residual
from wlr_render.diagnosis.prediction import Explanation, Hypothesis, Linearisation
from wlr_render.diagnosis.screening import HOPELESS, ScreenedHypothesis, Signatures, best_fit, screen
from wlr_render.diagnosis.settings import DEFAULT, Settings
from wlr_render.diagnosis.station_fields import station_fields
from wlr_render.diagnosis.weighed_readings import WeighedReadings
from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.polynomial import Box
from wlr_render.numerics.scatter import LOG10_ODDS, Scatter
from wlr_render.numerics.scatter_search import best_scatter, with_moved_captures

Progress = Callable[[str], None]

_NOTHING_MORE = "no other cause makes the readings more probable"
_FIELD_FIRST = "an effect of another shape than all causes explains more than they do together"
_FAR_MORE = 1.5  # least ratio of a field's gain to the causes' first-order gain: a full fit of causes may gain more
_SHAPED = 2  # most causes with SHAPE parameters that are fitted although a field explains far more
_NOTABLE = 1e-3  # least reduction of a part's excess variance, over the noise variance, if a cause acts on the part


@dataclass(frozen=True, eq=False)
class CandidateRanking:
    """The candidates for one more cause.

    Attributes:
        current: the fit to which the cause would be added.
        screened: first-order gain of each hypothesis on the subsample; largest first.
        fits: fits of candidates to all readings, best first, one per cause in its best variant; the last cause is the
            candidate.
        rough: likewise, fits of candidates to the subsample.
        field_gain: fall of -2 log evidence of the subsample by a field that explains far more than all causes together;
            0 without such a field.
    """

    current: Fit
    screened: tuple[ScreenedHypothesis, ...]
    fits: tuple[Fit, ...]
    rough: tuple[Fit, ...]
    field_gain: float = 0.0


@dataclass(frozen=True, eq=False)
class Selection:
    """The result of a selection.

    Attributes:
        fit: fit of all causes.
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
        full: all readings.
        subsample: some readings, for the first comparison.
        hypotheses: the candidates.
        progress: called with a sentence at each step.
        settings: thresholds.
        fields: fields at the stations, over the subsample.
        spot: spot on the combiner with finer fields.
        simulated: signatures of the hypotheses on the subsample, if already known.
    """

    full: WeighedReadings
    subsample: WeighedReadings
    hypotheses: Sequence[Hypothesis]
    progress: Progress = lambda _: None
    settings: Settings = DEFAULT
    fields: Sequence[StationField] = ()
    spot: Box | None = None
    simulated: Signatures | None = None

    @cached_property
    def signatures(self) -> Signatures:
        """Signatures of the hypotheses, with the columns of the fields."""
        if self.simulated is not None:
            return replace(self.simulated, readings=self.subsample)
        columns = [field.columns for field in self.fields]
        return Signatures.of(self.subsample, self.hypotheses, columns, self.progress)

    def contest(self, at: Fit) -> FieldContest:
        """Return the contest of all fields against a fit to the subsample."""
        return FieldContest(self.subsample, at, self.fields, self.signatures.fixed)

    def with_effects(self, effects: Sequence[LocatedEffect], beside: Explanation, constants: bool) -> "Search":
        """Return the same search with located effects of unknown coefficients.

        Args:
            effects: the effects.
            beside: causes; an effect at the station of a cause is made orthogonal to the cause's effect, so that the
                values of the cause stay determined.
            constants: whether an effect of the stage or of time keeps its constant, which a cause may explain.
        """
        located = [each.field for each in effects]
        each_with_fields = [(self.subsample, self.fields)]
        if self.full is not self.subsample:
            spot = self.spot if any(field.is_in_spot for field in located) else None
            each_with_fields.append((self.full, station_fields(self.full, located, spot)))
        sizes = np.repeat([each.size for each in effects], [each.acting.columns.shape[2] for each in effects])
        searched = []
        for readings, fields in each_with_fields:
            causes = readings.predictor.linearised(beside)
            columns = [_beyond(each.over(fields), causes, readings, constants) for each in effects]
            searched.append(replace(readings, effects=np.concatenate(columns, axis=2), effect_sizes=sizes))
        return replace(self, full=searched[-1], subsample=searched[0], simulated=self.signatures)

    def select(self, start: Explanation = Explanation()) -> Selection:  # noqa: B008
        """Add causes while each is worth it; if several were added, restart from the runners-up of the first place."""
        first = self.rank(self.refitted(start, Scatter.usual(len(self.full.observations.captures))))
        best = self._grown(first)
        if len(best.fit.explanation.hypotheses) > 1:
            for seed in first.fits[1:][: self.settings.restarts]:
                self.progress(f"again from {seed.explanation.names[-1]}")
                other = self._grown(self.rank(self._with_moved(seed)))
                if other.fit.minus_two_log_evidence < best.fit.minus_two_log_evidence:
                    best = replace(other, first=first)
        return best

    def on_subsample(self, found: Fit) -> Fit:
        """Fit noise and motions to the subsample, with the values of a fit to all readings."""
        at = found.at if self.full.predictor is self.subsample.predictor else None
        return _fitted(self.subsample, found.explanation, found.scatter, 0, at)

    def refitted(self, explanation: Explanation, scatter: Scatter) -> Fit:
        """Fit to all readings, and search again for moved captures."""
        return self._with_moved(_fitted(self.full, explanation, scatter))

    def _with_moved(self, found: Fit) -> Fit:
        """Search again for moved captures, and refit to all readings if they differ."""
        again, _ = with_moved_captures(self.full.sums_at(found.at), found.scatter)
        if np.array_equal(again.moved, found.scatter.moved):
            return found
        refit = _fitted(self.full, found.explanation, again)
        return refit if refit.minus_two_log_evidence < found.minus_two_log_evidence else found

    def _grown(self, start: CandidateRanking) -> Selection:
        """Add causes one at a time until the next one is refused."""
        at, most = start, self.settings.max_causes
        while True:
            if len(at.current.explanation.hypotheses) >= most:
                return Selection(at.current, start, f"{most} causes are the most that are searched for")
            refusal = self._refusal(at)
            if refusal:
                return Selection(at.current, start, refusal)
            at = self.rank(self.pruned(self._with_moved(at.fits[0])))

    def rank(self, current: Fit) -> CandidateRanking:
        """Rank the causes that are not yet selected."""
        taken = set(current.explanation.names)
        at = self.on_subsample(current)
        contest = self.contest(at)
        found = screen(
            self.signatures, at, [each for each in self.hypotheses if each.cause.name not in taken], contest.sums
        )
        self.progress(f"cause {len(taken) + 1}: {', '.join(each.hypothesis.cause.name for each in found[:3])}")
        field_gain = self._field_gain(contest, found)
        fits, rough = self._candidates(at, found, field_gain)
        return self._equally_searched(CandidateRanking(current, tuple(found), tuple(fits), tuple(rough), field_gain))

    def _field_gain(self, contest: FieldContest, screened: Sequence[ScreenedHypothesis]) -> float:
        """Return the fall of -2 log evidence by the best field if it far exceeds the fall by all causes, else 0."""
        worth = self.settings.least_log10_odds / LOG10_ODDS
        if not self.fields or not screened or max(each.gain for each in screened) < worth:
            return 0.0
        best = contest.ranked[0].log10_odds / LOG10_ODDS
        shapes = [each.columns for each in screened if each.columns is not None]
        by_causes = max(screened[0].gain, contest.gain_of_best(shapes, self.settings.max_causes))
        return best if best > _FAR_MORE * by_causes + self.settings.close_evidence else 0.0

    def _candidates(
        self, at: Fit, screened: Sequence[ScreenedHypothesis], field_gain: float
    ) -> tuple[list[Fit], list[Fit]]:
        """Return fits of the promising hypotheses, best first: to all readings, and to the subsample."""
        settings = self.settings
        if not screened or screened[0].gain < HOPELESS:
            return [], []
        least = min(settings.min_relative_gain * max(screened[0].gain, field_gain), screened[0].gain)
        # A gain that is too small on the subsample may suffice on all readings; one fit decides.
        most = settings.max_fits if LOG10_ODDS * screened[0].gain > settings.least_log10_odds else 1
        kept = [each for each in screened if each.gain >= least][:most]
        if field_gain:
            # Only effects with a fitted shape can gain more than their first-order gain.
            kept = [*kept[:1], *(each for each in kept[1:] if each.hypothesis.cause.is_shaped)][: _SHAPED + 1]
        self.progress(f"fitting {', '.join(sorted({each.hypothesis.cause.name for each in kept}))}")
        rough = _possible((best_fit(self.subsample, at, each) for each in kept), settings)
        if not rough:
            return [], []
        least_cost = rough[0].minus_two_log_evidence
        if field_gain and at.minus_two_log_evidence - least_cost < field_gain:
            return [], []
        close = [each for each in rough if each.minus_two_log_evidence - least_cost < settings.close_evidence]
        close = close[: settings.max_contenders]
        fits = _possible((fit(self.full, each.explanation, each.scatter) for each in close), settings)
        return (_best_of_each(fits), _best_of_each(rough)) if fits else ([], [])

    def improvement(self, before: Fit, after: Fit) -> HeldOutImprovement:
        """Return the improvement of held-out captures from one fit to another, whitened with the latter's errors."""
        observations, whiten = self.full.observations, self.full.whitening(after.scatter)
        old, new = (whiten(held_out_residual(each, observations)) for each in (before, after))
        return held_out_improvement(old, new, observations.group)

    def _equally_searched(self, at: CandidateRanking) -> CandidateRanking:
        """Refit the current explanation from the best candidate's sizes of noise and motions; keep the better fit."""
        if not at.fits:
            return at
        again = fit(self.full, at.current.explanation, at.fits[0].scatter, 0, at=at.current.at)
        if again is None or again.minus_two_log_evidence >= at.current.minus_two_log_evidence:
            return at
        return replace(at, current=again)

    def _refusal(self, at: CandidateRanking) -> str:
        """Return the reason against adding the best candidate; empty if it is worth adding."""
        if not at.fits:
            return _FIELD_FIRST if at.field_gain else _NOTHING_MORE
        best, name = at.fits[0], at.fits[0].explanation.names[-1]
        odds = LOG10_ODDS * (at.current.minus_two_log_evidence - best.minus_two_log_evidence)
        if odds < 0.0:
            return _NOTHING_MORE
        if odds < self.settings.least_log10_odds:
            return f"{name} comes next, but the odds for it are 10^{odds:.1f} only"
        share = self._share_explained(at.current, best)
        if share < self.settings.min_share_explained:
            return (
                f"{name} comes next, but explains only {100 * share:.0f} % of the excess over "
                "the noise, and more than noise would be left"
            )
        return ""

    def _share_explained(self, before: Fit, after: Fit) -> float:
        """Return the largest share of a part's excess over the noise that is explained; 1 where only noise is left.

        If an unlisted effect is present, a cause that explains little is more often a spurious match than a true one.
        Captures that moved in both fits are not counted.
        """
        shares, counted = [0.0], ~(before.scatter.moved & after.scatter.moved)
        for part in np.unique(self.full.observations.part):
            old, new = (self.full.excess(each.scatter, int(part), counted) for each in (before, after))
            if new < old - _NOTABLE:
                at_noise = after.scatter.is_ordinary(part, self.settings.material_excess)
                shares.append(1.0 if at_noise else (old - new) / old)
        return max(shares)

    def pruned(self, found: Fit) -> Fit:
        """Drop every cause that a later one has made redundant."""
        for place in reversed(range(len(found.explanation.hypotheses) - 1)):
            if self._loss_without(found, place) > self.settings.close_evidence:
                continue
            without = fit(self.full, found.explanation.without(place), found.scatter)
            if without is not None and without.minus_two_log_evidence < found.minus_two_log_evidence:
                found = without
        return found

    def _loss_without(self, found: Fit, place: int) -> float:
        """Return the rise of -2 log evidence without one of the causes, to first order."""
        rest, residual = found.owner != place, found.residual_without(place)
        sums = self.full.sums(residual, found.at.jacobian[:, :, rest], -found.at.off_prior[rest])
        return best_scatter(sums, found.scatter)[1] - best_scatter(self.full.sums_at(found.at), found.scatter)[1]


def _beyond(effect: LocatedEffect, at: Linearisation, readings: WeighedReadings, constants: bool) -> FloatArray:
    """Return the functions (n, 2, c) of an effect, made orthogonal to causes of its station; see `with_effects`."""
    functions = effect.acting.columns
    if not constants and effect.field.station in ELSEWHERE:
        functions = functions * (effect.acting.order > 0)
    hypotheses = at.explanation.hypotheses
    stations = np.array([each.cause.station for each in hypotheses for _ in each.cause.parameters])
    same = stations[at.free] == effect.field.station if at.free.size else np.zeros(0, dtype=bool)
    if not same.any():
        return functions
    causes = at.jacobian[:, :, same]
    white = readings.shared(causes).reshape(-1, int(same.sum()))
    share = np.linalg.lstsq(white, readings.shared(functions).reshape(len(white), -1), rcond=None)[0]
    return np.asarray(functions - causes @ share)


def _fitted(
    readings: WeighedReadings,
    explanation: Explanation,
    scatter: Scatter,
    iterations: int = 12,
    at: Linearisation | None = None,
) -> Fit:
    """Fit from an explanation's values, or from its null values if those do not predict every reading."""
    found = fit(readings, explanation, scatter, iterations, at=at)
    if found is None:
        null = replace(explanation, values=tuple(each.cause.null() for each in explanation.hypotheses))
        found = fit(readings, null, scatter, iterations)
    assert found is not None, "the nominal bench predicts all observations"
    return found


def _possible(fits: Iterable[Fit | None], settings: Settings) -> list[Fit]:
    """Return the fits with physical values, best evidence first."""
    possible = (each for each in fits if each is not None and is_physical(each, settings))
    return sorted(possible, key=lambda each: each.minus_two_log_evidence)


def _best_of_each(fits: Sequence[Fit]) -> list[Fit]:
    """Return the first fit for each last cause."""
    firsts: dict[str, Fit] = {}
    for each in fits:
        firsts.setdefault(each.explanation.names[-1], each)
    return list(firsts.values())
