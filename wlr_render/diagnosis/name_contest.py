"""Names of causes against fields: a cause that a displacement of any shape does as well has not earned its name."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from wlr_render.diagnosis.field_contest import FieldContest
from wlr_render.diagnosis.field_terms import ELSEWHERE
from wlr_render.diagnosis.located_effects import LocatedEffect
from wlr_render.numerics.arrays import BoolArray, FloatArray, IntArray
from wlr_render.numerics.scatter import LOG10_ODDS, Known

_OWN_SHAPE = 0.1  # share of a cause's effect outside a field, from which the field gets the cause's shape as well
_MEAN_OF_DRIFT = 4.0  # size of a drift's constant over its other terms'; rms 3.5 to 5.2 for walks of degree 2 to 12
_NEARLY_ALL = 0.95  # share of the evidence for cause and field together from which a cause needs no field


@dataclass(frozen=True, eq=False)
class NameContest(FieldContest):
    """The causes of a fit against the fields; attributes as in `FieldContest`."""

    def odds_of_cause(self, number: int, station: str, beside: Sequence[LocatedEffect]) -> tuple[float, str]:
        """Return log10 odds for a cause against the fields that come closest, and the station of these.

        A prism in the view turns it as a wrong pose of the target does: a name that a field of another station
        could take is not earned.

        Args:
            number: index of the cause in the fit.
            station: its station.
            beside: effects located in addition to it.
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

        If cause and field explain more together, the fields get the cause's shape as well: otherwise they could not
        imitate it, and its name would always win. This does not apply to a cause that explains nearly all alone.
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
            self._least_of(columns, unnamed, span[self._beyond(columns, span) > _OWN_SHAPE])[0] for columns in tried
        )
        # Together with a field of its station a cause keeps its name only if it is the better of the two; otherwise it
        # is a part of that field with a similar shape.
        with_name = min(alone, both) if alone < field else alone
        return float(LOG10_ODDS * (min(nothing, spanned + charge) - with_name))

    def _odds_beside(self, mine: BoolArray, station: str, beside: Sequence[LocatedEffect]) -> float:
        """Log10 odds for a cause against none where a field of another station may explain the same."""
        named, unnamed = self._with_and_without(mine, station, beside)
        tried = self._tried_at(station)
        means = (1.0, _MEAN_OF_DRIFT) if station in ELSEWHERE else (1.0,)
        without, with_name = (
            min(self._least_of(columns, known, mean=mean)[0] for columns in tried for mean in means)
            for known in (unnamed, named)
        )
        return LOG10_ODDS * (without - with_name)

    def _odds_against(self, mine: BoolArray, station: str, beside: Sequence[LocatedEffect]) -> float:
        """Return log10 odds for causes against the fields of a station that replace them.

        A constant at a station in `ELSEWHERE` is a motion of another station as a whole: it rivals no name.
        """
        named, unnamed = self._with_and_without(mine, station, beside)
        tried = self._tried_at(station, constants=station not in ELSEWHERE)
        if not tried:
            return float("inf")
        field = self._least_of_any(tried, unnamed) + 2.0 * float(np.log(len(tried)))
        return LOG10_ODDS * (field - self._least(named))

    def _least_of_any(self, tried: Sequence[IntArray], known: Known) -> float:
        return min(self._least_of(columns, known)[0] for columns in tried)

    def _tried_at(self, station: str, constants: bool = True) -> list[IntArray]:
        """Columns of all fields of a station, by degree; without its constants, if it has others."""
        tried = [
            (number, self._columns(number, degree))
            for number, field in enumerate(self.fields)
            for degree in field.degrees
            if field.station == station
        ]
        if constants:
            return [columns for _, columns in tried]
        varying = [columns[self.fields[n].order[columns - self._first[n]] > 0] for n, columns in tried]
        return [columns for columns in varying if columns.size]

    def _with_and_without(self, mine: BoolArray, station: str, beside: Sequence[LocatedEffect]) -> tuple[Known, Known]:
        """Return the model with causes, and without them, at their null values.

        `mine` is a mask (p,) of these causes' columns in the fit.
        """
        elsewhere = [each for each in beside if each.field.station != station]
        unnamed = self._known(elsewhere, self._causes[~mine])
        # The causes' own values count from none.
        unnamed = unnamed._replace(moved=self._causes[mine], by=-self.found.effects[mine])
        return self._known(elsewhere, self._causes), unnamed

    def _beyond(self, columns: IntArray, span: IntArray) -> FloatArray:
        """Share of each column of a span (s,) that lies outside some columns, as the readings weigh them."""
        sums, _ = self._scatters[0]
        own = sums.information[np.ix_(columns, columns)]
        across = sums.information[np.ix_(columns, span)]
        ridge = 1e-9 * float(np.trace(own)) * np.eye(len(columns))
        inside = np.sum(across * np.linalg.solve(own + ridge, across), axis=0)
        return np.asarray(np.sqrt((1.0 - inside / np.diag(sums.information)[span]).clip(0.0)))
