"""Joint search for causes and located effects: effects in addition to causes, and causes that no field explains."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

from wlr_render.bench.bench import Bench
from wlr_render.diagnosis.cause_selection import Search
from wlr_render.diagnosis.coherence import FineEffect
from wlr_render.diagnosis.diagnosis import StationEffect, TriedField
from wlr_render.diagnosis.field_contest import MOST_EFFECTS, FieldContest
from wlr_render.diagnosis.field_terms import LocatedEffect
from wlr_render.diagnosis.fit import Fit
from wlr_render.diagnosis.settings import BEYOND_DOUBT
from wlr_render.numerics.scatter import Scatter

_ROUNDS = 2  # number of searches for causes in addition to located effects


@dataclass(frozen=True, eq=False)
class Located:
    """Causes with better evidence than any field, and the effects located in addition to them.

    Attributes:
        search: the search with the effects included.
        found: the fit of the causes to all readings.
        contest: contest of the fields with these causes, on a subsample.
        effects: the smooth located effects.
        tried: all fields that were judged.
        dropped: a sentence on each cause that was dropped because a field explains the same.
        odds: log10 odds for the name of each cause of the fit against the fields.
    """

    search: Search
    found: Fit
    contest: FieldContest
    effects: tuple[LocatedEffect, ...]
    tried: tuple[TriedField, ...]
    dropped: tuple[str, ...]
    odds: tuple[float, ...]

    @cached_property
    def scatter(self) -> Scatter:
        """Sizes of noise and motions with causes and effects included."""
        return self.contest.scatter_beside(self.effects)

    def bench(self, corrected: Bench) -> Bench:
        """Add the effects that a bench file can state to a bench."""
        pairs = zip(self.effects, self.contest.values_and_covariances(self.effects, self.scatter), strict=True)
        added = [each for effect, estimate in pairs for each in effect.in_bench(*estimate)]
        return replace(corrected, effects=(*corrected.effects, *added)) if added else corrected

    def about_rests(self) -> tuple[str, ...]:
        """Return a sentence on remainders of the located effects, if the corrected bench has effects for them."""
        rests = [
            f"{each.field.form} by {each.field.coordinates} ({each.field.station}, log10 odds {each.log10_odds:.1f})"
            for each in self.effects
            if each.is_rest
        ]
        if not rests:
            return ()
        return (f"what the located effects describe imperfectly is in the corrected bench: {'; '.join(rests)}",)

    def fine_beside(self, fine: FineEffect | None) -> FineEffect | None:
        """Return the fine effect, or None if a smooth one has better odds: its remainder may look like one."""
        smooth = max((effect.log10_odds for effect in self.effects), default=0.0)
        return None if fine is None or fine.log10_odds < smooth else fine

    def structure(self, effects: Sequence[StationEffect]) -> tuple[str, ...]:
        """Return a sentence on a field with certain odds that fails to predict held-out captures, if there is one."""
        best = self.tried[0] if self.tried else None
        if effects or best is None or best.log10_odds < BEYOND_DOUBT:
            return ()
        return (
            f"a field of {best.coordinates} ({best.station}: {best.displaced}) has log10 odds of {best.log10_odds:.0f} "
            "and does not predict captures left out: something is left that no cause and no field describes",
        )


def locate(search: Search, found: Fit) -> Located:
    """Locate effects in addition to the causes, and causes in addition to these effects, until none is added.

    Causes are searched for with the first effect alone: further fields could absorb the effect of a cause.
    """
    located = _standing(search, found, most=1)
    for _ in range(_ROUNDS):
        if not located.effects:
            break
        beside = search.with_effects(located.effects, located.found.explanation, constants=False)
        more = beside.select(located.found.explanation).fit
        again = _standing(search, more, MOST_EFFECTS)
        is_last = again.found.explanation.names == located.found.explanation.names
        located = replace(again, dropped=(*located.dropped, *again.dropped))
        if is_last:
            break
    if not located.effects:
        return located
    contest = located.contest.with_effects(located.effects)
    effects = (*located.effects, *contest.located(search.settings.least_log10_odds, before=located.effects))
    return replace(located, contest=contest.with_effects(effects), effects=effects)


def _standing(search: Search, found: Fit, most: int) -> Located:
    """Locate at most `most` effects in addition to the causes; drop causes that a field can replace, one at a time."""
    least, dropped = search.settings.least_log10_odds, list[str]()
    while True:
        contest = search.contest(search.on_subsample(found))
        effects = contest.located(least, most)
        odds = [
            contest.odds_of_cause(number, hypothesis.cause.station, effects)
            for number, hypothesis in enumerate(found.explanation.hypotheses)
        ]
        together = contest.odds_of_all_causes(effects) if len(odds) > 1 else (float("inf"), "")
        if not odds or min(*odds, together)[0] > least:
            break
        weakest = odds.index(min(odds))
        weakest_odds, rival = min(min(odds), together)
        cause = found.explanation.hypotheses[weakest].cause
        dropped.append(
            f"{cause.name} would explain part of it, but a field of the {rival} explains as much: log10 "
            f"odds for the name are {weakest_odds:.1f}, and it is not named"
        )
        found = search.refitted(found.explanation.without(weakest), found.scatter)
    tried = [
        TriedField(each.field.station, each.field.coordinates, each.field.form, each.degree, each.log10_odds)
        for each in contest.ranked
    ]
    if effects:
        alone, constants = search, not found.explanation.hypotheses
        search = alone.with_effects(effects, found.explanation, constants)
        found = search.refitted(found.explanation, contest.scatter_beside(effects))
        # The effects' coefficients must match the causes' values in this joint fit.
        contest = alone.contest(alone.on_subsample(found))
    return Located(
        search, found, contest, tuple(effects), tuple(tried), tuple(dropped), tuple(each for each, _ in odds)
    )
