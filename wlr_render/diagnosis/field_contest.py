"""Effects that are located at a station by evidence: fields compete with each other, with causes, and with chance.

A cause is not named if a displacement of arbitrary shape explains the readings equally well.

All fields and the causes of a fit are columns of one linear model with random motions of the captures (`scatter`).
The evidence for a field is the probability of the readings, with its coefficients and their unknown common size
integrated out; the known causes and the effects located before are integrated out, too. Everything follows from one
set of sums over the readings.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise, product

import numpy as np

from wlr_render.bench.bench_effects import BenchEffect
from wlr_render.diagnosis.field_terms import ELSEWHERE, LocatedEffect, StationField
from wlr_render.diagnosis.fit import Fit
from wlr_render.diagnosis.held_out import HeldOutImprovement, held_out_improvement, left_out_residual
from wlr_render.diagnosis.settings import BEYOND_DOUBT
from wlr_render.diagnosis.weighed_readings import WeighedReadings
from wlr_render.numerics.arrays import BoolArray, FloatArray, IntArray
from wlr_render.numerics.scatter import (
    LOG10_ODDS,
    Known,
    Marginal,
    Scatter,
    ScatterSums,
    costs_of_sizes,
    marginal,
    surprise,
)
from wlr_render.numerics.scatter_search import best_scatter

_SIZES = np.geomspace(0.01, 300.0, 30)  # sizes of a field's coefficients to try, in units of sigma
_LESS_MOTION = (1.0, 0.3, 0.05)  # sizes of the captures' motions to try, relative to those without the field
MOST_EFFECTS = 3
"""Most effects located in one session, and most remainders of these."""
_FAIR_SHARE = 0.25  # least log odds of a further effect, relative to the first effect's
_PREDICTS = 2.0  # standard errors by which held-out captures must be predicted better
_NONE = np.zeros(0, dtype=np.int64)  # no columns
_OWN_SHAPE = 0.1  # share of a cause's effect outside a field from which the field also gets the cause's shape
_MEAN_OF_DRIFT = 4.0  # size of a drift's constant over its other terms'; rms 3.5 to 5.2 for walks of degree 2 to 12
_NEARLY_ALL = 0.95  # share of the evidence of cause and field together from which the cause needs no field
_LARGER_NOISE = 1.05  # noise factor of the fit above which it is tried in addition to 1


@dataclass(frozen=True, eq=False)
class FieldContest:
    """The causes of a fit and all fields over the same readings.

    Attributes:
        readings: the readings.
        found: the fit to the readings.
        fields: the competing fields.
        fixed: sums over the columns of the fields, after any others.
    """

    readings: WeighedReadings
    found: Fit
    fields: Sequence[StationField]
    fixed: ScatterSums

    @cached_property
    def sums(self) -> ScatterSums:
        """Sums over all fixed columns, then the fit's columns."""
        return self.readings.sums_at(self.found.at, self.fixed)

    @cached_property
    def _first(self) -> IntArray:
        """First column of each field."""
        sizes = [field.order.size for field in self.fields]
        return np.asarray(len(self.fixed.mean) - sum(sizes) + np.cumsum([0, *sizes])[: len(sizes)])

    @cached_property
    def _causes(self) -> IntArray:
        """Columns of the fit's causes."""
        return np.asarray(len(self.fixed.mean) + np.arange(self.found.at.free.size))

    @cached_property
    def _scatters(self) -> list[tuple[Marginal, float]]:
        """Sums over the readings, with the prior cost, for each size of noise and motions to try."""
        scatter = self.found.scatter
        noises = [np.ones_like(scatter.noise)]
        if np.max(scatter.noise) > _LARGER_NOISE:
            noises.append(scatter.noise)
        tried = [
            Scatter(noise, less * scatter.shift_um, less * scatter.turn_urad, scatter.moved)
            for less, noise in product(_LESS_MOTION, noises)
        ]
        return [(marginal(self.sums, each), surprise(each, self.sums)) for each in tried]

    def _columns(self, number: int, degree: int, above: int = -1) -> IntArray:
        return np.asarray(self._first[number] + np.flatnonzero(self.fields[number].counting(degree, above)))

    def _known(self, effects: Iterable[LocatedEffect], causes: IntArray) -> Known:
        """Return the columns of causes and of effects, with their prior sigmas."""
        columns, sigma = [causes], [np.ones(causes.size)]
        for effect in effects:
            columns.append(self._columns(self.fields.index(effect.field), effect.degree, effect.above))
            sigma.append(np.full(columns[-1].size, effect.size))
        return Known(np.concatenate(columns), np.concatenate(sigma))

    def located(
        self, least_log10_odds: float, most: int = MOST_EFFECTS, before: Sequence[LocatedEffect] = ()
    ) -> list[LocatedEffect]:
        """Return the effects that the readings show in addition to the causes, best evidence first.

        Each has good odds and improves the prediction of captures held out of its fit; a spurious match does not.
        Further effects need a fair share of the first effect's odds, because a field that describes an effect
        imperfectly leaves a small residual everywhere. Given the effects located `before`, return their remainders.
        """
        effects: list[LocatedEffect] = []
        while len(effects) < most:
            beside = [*before, *effects]
            best = next(iter(self._ranked_beside(beside, further=bool(before)) if beside else self.ranked), None)
            least = max(least_log10_odds, _FAIR_SHARE * effects[0].log10_odds if effects and not before else 0.0)
            if best is None or best.log10_odds < least:
                break
            # Too few captures see a spot for cross-validation; but cells of different captures agree there.
            is_plain = best.field.is_in_spot and best.log10_odds > BEYOND_DOUBT and not beside
            scatter = self.scatter_beside([*beside, best])
            if not is_plain and self.held_out(best, scatter, beside)[0].significance < _PREDICTS:
                break
            effects.append(replace(best, is_rest=bool(before)))
        return effects

    def with_effects(self, effects: Sequence[LocatedEffect]) -> "FieldContest":
        """Return the contest with the residual corrected for the nonlinear part of the effects at their values."""
        predictor, linear = self.readings.predictor, self.found.at.residual
        added, scatter = list[BenchEffect](), self.scatter_beside(effects)
        for effect, (values, covariance) in zip(effects, self.values_and_covariances(effects, scatter), strict=True):
            stated = effect.in_bench(values, covariance)
            if stated:
                added += stated
                linear = linear - effect.acting.columns @ values
        nominal = self.found.explanation.bench(predictor.observations.nominal)
        exact = predictor.residual_of_bench(replace(nominal, effects=(*nominal.effects, *added)))
        curved = np.where(np.isfinite(exact), exact - linear, 0.0)
        at = replace(self.found.at, residual=self.found.at.residual + curved)
        return replace(self, found=replace(self.found, at=at))

    def gain_of_best(self, shapes: Sequence[IntArray], most: int) -> float:
        """Return the fall of -2 log evidence by the best shapes together, chosen one at a time.

        Args:
            shapes: fixed columns of each shape, in prior sigmas.
            most: largest number of shapes.
        """
        known, left = self._known((), self._causes), list(shapes)
        least = start = self._least(known)
        for _ in range(most):
            more = [Known(np.r_[known.columns, each], np.r_[known.sigma, np.ones(len(each))]) for each in left]
            tried = [self._least(each) for each in more]
            if not tried or min(tried) >= least:
                break
            least, best = min(tried), int(np.argmin(tried))
            known = more[best]
            del left[best]
        return start - least

    @cached_property
    def ranked(self) -> list[LocatedEffect]:
        """All fields, each added to the causes with its best degree and size; best first."""
        return self._ranked_beside((), further=False)

    def _ranked_beside(self, beside: Sequence[LocatedEffect], further: bool) -> list[LocatedEffect]:
        """Return all fields, each added to the causes and some effects, best first; all have the same penalty."""
        known = self._known(beside, self._causes)
        # Functions of higher order than the located ones may have a different size.
        taken = {id(each.field): each.degree for each in sorted(beside, key=lambda each: each.degree)}
        tried = [
            (number, degree, taken.get(id(field), -1))
            for number, field in enumerate(self.fields)
            for degree in field.degrees
            if id(field) not in taken or (further and field.counting(degree, taken[id(field)]).any())
        ]
        if not tried:
            return []
        none = self._least(known)
        charge = float(np.log10(len(tried)))
        best: dict[int, LocatedEffect] = {}
        for number, degree, above in tried:
            least, size = self._least_of((number, degree, above), known)
            odds = LOG10_ODDS * (none - least) - charge
            if number not in best or odds > best[number].log10_odds:
                best[number] = LocatedEffect(self.fields[number], degree, size, odds, above=above)
        ranked = sorted(best.values(), key=lambda each: -each.log10_odds)
        of_next = next((each for each in ranked if each.field.station != ranked[0].field.station), None)
        if of_next is not None:
            odds = ranked[0].log10_odds - of_next.log10_odds
            ranked[0] = replace(ranked[0], next_station=of_next.field.station, odds_against_next=odds)
        return ranked

    def _least(self, known: Known) -> float:
        """Return -2 log evidence of the known causes and effects alone."""
        return min(sums.of_columns(known).minus_two_log_evidence + cost for sums, cost in self._scatters)

    def _least_of(
        self, tried: tuple[int, int, int], known: Known, added: IntArray = _NONE, mean: float = 1.0
    ) -> tuple[float, float]:
        """Return -2 log evidence of a field with the known columns, over all sizes, and its most probable size.

        Args:
            tried: number of the field, its degree, and the order above which its functions count.
            known: the columns that are integrated out.
            added: columns of causes added to the field, at unit rms.
            mean: size of the field's constants relative to the size of its other coefficients.
        """
        columns, field = self._columns(*tried), self.fields[tried[0]]
        own = self.found.at.jacobian[:, :, added - len(self.fixed.mean)]
        constant = field.order[field.counting(*tried[1:])] == 0
        scale = np.r_[np.where(constant, mean, 1.0), 1.0 / np.sqrt(np.mean(own**2, axis=(0, 1)))]
        bases, costs = [], []
        for sums, cost in self._scatters:
            alone = sums.folded(known, np.r_[columns, added])
            bases.append(alone.minus_two_log + cost)
            costs.append(costs_of_sizes(scale[:, None] * alone.information * scale, scale * alone.gradient, _SIZES))
        # All sizes are equally likely a priori.
        least = np.array(bases) - 2.0 * (np.logaddexp.reduce(-0.5 * np.array(costs), axis=1) - np.log(len(_SIZES)))
        best = int(np.argmin(least))
        charge = 2.0 * np.log(field.alternatives)
        return float(least[best] + charge), float(_SIZES[int(np.argmin(costs[best]))])

    def scatter_beside(self, effects: Sequence[LocatedEffect]) -> Scatter:
        """Return the sizes of noise and motions with the causes and effects included."""
        known = self._known(effects, self._causes)
        return best_scatter(self.sums.of_columns(known.columns, sigma=known.sigma), self.found.scatter)[0]

    def values_and_covariances(
        self, effects: Sequence[LocatedEffect], scatter: Scatter
    ) -> list[tuple[FloatArray, FloatArray]]:
        """Return the most probable coefficients (c,) and covariance (c, c) of each effect, the causes as fitted.

        The effects are fitted together.
        """
        known = self._known(effects, _NONE)
        sums = marginal(self.sums.of_columns(known.columns, sigma=known.sigma), scatter)
        values, covariance = sums.values, sums.covariance
        ends = np.cumsum([0, *(effect.acting.columns.shape[2] for effect in effects)])
        slices = [slice(start, end) for start, end in pairwise(ends)]
        return [(values[each], covariance[each, each]) for each in slices]

    def left(self, effects: Sequence[LocatedEffect], scatter: Scatter) -> FloatArray:
        """Return the residual (n, 2) after causes and effects."""
        left = self.found.at.residual
        for effect, (values, _) in zip(effects, self.values_and_covariances(effects, scatter), strict=True):
            left = left - effect.acting.columns @ values
        return left

    def held_out(
        self, effect: LocatedEffect, scatter: Scatter, beside: Sequence[LocatedEffect] = ()
    ) -> tuple[HeldOutImprovement, float]:
        """Return the improvement of captures held out of an effect's fit, and the share of their excess it removes.

        Args:
            effect: the effect.
            scatter: sizes of noise and motions with all effects included.
            beside: effects found before, with their values from all captures.
        """
        group, residual = self.readings.observations.group, self.left(beside, scatter)
        whiten = self.readings.whitening(scatter)
        white, left = whiten(effect.acting.columns), whiten(residual)
        after = left_out_residual(white, left, group, effect.size)
        acts = np.isin(group, np.unique(group[np.any(effect.acting.columns != 0.0, axis=(1, 2))]))
        before_sum, after_sum = (float(np.sum(each[acts] ** 2)) for each in (left, after))
        expected = 2.0 * float(acts.sum())
        removed = before_sum - after_sum
        share = removed / max(before_sum - expected, removed, 1e-9)
        return held_out_improvement(left[acts], after[acts], group[acts]), share

    def odds_of_cause(self, number: int, station: str, beside: Sequence[LocatedEffect]) -> tuple[float, str]:
        """Return log10 odds for a cause against the closest rival fields, and the station of these fields.

        Fields of other stations are rivals, too: a prism in the view turns it just as a wrong pose of the target does.

        Args:
            number: index of the cause in the fit.
            station: station of the cause.
            beside: effects located in addition to the cause.
        """
        located, mine = {each.field.station for each in beside}, self.found.owner == number
        odds = [(self._odds_at_its_station(mine, station, beside), station)]
        for other in sorted({field.station for field in self.fields} - {station}):
            against = self._odds_beside if other in located else self._odds_against
            odds.append((against(mine, other, beside), other))
        return min(odds)

    def odds_of_all_causes(self, beside: Sequence[LocatedEffect]) -> tuple[float, str]:
        """Return log10 odds for all causes against one field in their place, and the station of that field."""
        every = np.ones(self.found.at.free.size, dtype=bool)
        stations = sorted({field.station for field in self.fields} - {each.field.station for each in beside})
        odds = [(self._odds_against(every, station, beside), station) for station in stations]
        return min(odds, default=(float("inf"), ""))

    def _odds_at_its_station(self, mine: BoolArray, station: str, beside: Sequence[LocatedEffect]) -> float:
        """Return log10 odds for a cause, alone or with a field, against the fields of its station.

        If cause and field explain more together, the fields also get the cause's shape: otherwise they could not
        imitate the cause, and its name would always win. This does not apply to a cause that alone explains nearly all.
        """
        named, unnamed = self._with_and_without(mine, station, beside)
        tried, span = self._tried_at(station), unnamed.moved
        if not tried:
            return float("inf")
        charge = 2.0 * float(np.log(len(tried)))
        alone, nothing = self._least(named), self._least(unnamed)
        both, field = (self._least_of_any(tried, known) + charge for known in (named, unnamed))
        if nothing - alone > _NEARLY_ALL * (nothing - min(alone, both)):
            return float(LOG10_ODDS * (min(nothing, field) - min(alone, both)))
        spanned = min(
            self._least_of(each, unnamed, span[self._beyond(self._columns(*each), span) > _OWN_SHAPE])[0]
            for each in tried
        )
        # A cause together with a field of its station keeps its name only if it is the better of the two; otherwise
        # its effect is a part of that field.
        with_name = min(alone, both) if alone < field else alone
        return float(LOG10_ODDS * (min(nothing, spanned + charge) - with_name))

    def _odds_beside(self, mine: BoolArray, station: str, beside: Sequence[LocatedEffect]) -> float:
        """Return log10 odds for a cause against no cause, where a field of another station may explain the same."""
        named, unnamed = self._with_and_without(mine, station, beside)
        tried = self._tried_at(station)
        means = (1.0, _MEAN_OF_DRIFT) if station in ELSEWHERE else (1.0,)
        without, with_name = (
            min(self._least_of(each, known, mean=mean)[0] for each in tried for mean in means)
            for known in (unnamed, named)
        )
        return LOG10_ODDS * (without - with_name)

    def _odds_against(self, mine: BoolArray, station: str, beside: Sequence[LocatedEffect]) -> float:
        """Return log10 odds for causes against the fields of a station that replace them.

        A constant at a station in `ELSEWHERE` moves another station as a whole, so that it rivals no cause.
        """
        named, unnamed = self._with_and_without(mine, station, beside)
        tried = self._tried_at(station, constants=station not in ELSEWHERE)
        if not tried:
            return float("inf")
        field = self._least_of_any(tried, unnamed) + 2.0 * float(np.log(len(tried)))
        return LOG10_ODDS * (field - self._least(named))

    def _least_of_any(self, tried: Sequence[tuple[int, int, int]], known: Known) -> float:
        return min(self._least_of(each, known)[0] for each in tried)

    def _tried_at(self, station: str, constants: bool = True) -> list[tuple[int, int, int]]:
        """Return all fields of a station with their degrees, with or without constants."""
        above = -1 if constants else 0
        return [
            (number, degree, above)
            for number, field in enumerate(self.fields)
            for degree in field.degrees
            if field.station == station and field.counting(degree, above).any()
        ]

    def _with_and_without(self, mine: BoolArray, station: str, beside: Sequence[LocatedEffect]) -> tuple[Known, Known]:
        """Return the model with causes, and the model with these causes at their null values.

        `mine` is a mask (p,) of these causes' columns in the fit.
        """
        elsewhere = [each for each in beside if each.field.station != station]
        unnamed = self._known(elsewhere, self._causes[~mine])
        # The residual is at the fitted values, so moving by minus the values removes the causes.
        unnamed = unnamed._replace(moved=self._causes[mine], by=-self.found.effects[mine])
        return self._known(elsewhere, self._causes), unnamed

    def _beyond(self, columns: IntArray, span: IntArray) -> FloatArray:
        """Return the share of each column of `span` (s,) outside the space of `columns`, weighted by the readings."""
        sums, _ = self._scatters[0]
        own = sums.information[np.ix_(columns, columns)]
        across = sums.information[np.ix_(columns, span)]
        ridge = 1e-9 * float(np.trace(own)) * np.eye(len(columns))
        inside = np.sum(across * np.linalg.solve(own + ridge, across), axis=0)
        return np.asarray(np.sqrt((1.0 - inside / np.diag(sums.information)[span]).clip(0.0)))
