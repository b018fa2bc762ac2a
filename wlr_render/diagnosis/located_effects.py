"""Effects that are located at a station: a field, its degree and size, and the odds for it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from wlr_render.bench.bench_effects import AnyFunction, BenchEffect
from wlr_render.diagnosis.field_terms import StationField
from wlr_render.numerics.arrays import FloatArray


@dataclass(frozen=True, eq=False)
class LocatedEffect:
    """A field that the readings show.

    Attributes:
        field: where and how it acts.
        degree: highest order of its functions.
        above: order above which its functions count; functions up to it belong to another effect. -1 for all.
        size: most probable size of its coefficients, in units of sigma.
        log10_odds: for it against no effect, given the known causes and effects.
        next_station: the station of next best evidence; empty without one.
        odds_against_next: log10 odds against that station.
        is_rest: whether it may be a remainder of the effects located before it.
    """

    field: StationField
    degree: int
    size: float
    log10_odds: float
    next_station: str = ""
    odds_against_next: float = float("inf")
    above: int = -1
    is_rest: bool = False

    def over(self, fields: Sequence[StationField]) -> "LocatedEffect":
        """Return the same effect on other readings, of which these are the fields."""
        return replace(self, field=next(each for each in fields if each.kind == self.field.kind))

    @cached_property
    def acting(self) -> StationField:
        """The field of the functions that count."""
        return self.field.selected(self.field.counting(self.degree, self.above))

    def size_of(self, values: FloatArray, covariance: FloatArray) -> tuple[float, float, str]:
        """Return the rms displacement over the readings that feel the field, its standard error and its unit.

        Of shifts and turns, return the one with the larger ratio to its error.

        Args:
            values: (c,) coefficients.
            covariance: (c, c) of them.
        """
        units = self.field.unit.split(", ")
        if self.field.period:  # the constant term is not part of the wave
            varies = self.acting.order > 0
            values, covariance = values * varies, covariance * np.outer(varies, varies)

        def by_unit(coefficients: FloatArray) -> FloatArray:
            """Return the displacement (units, n, k)."""
            return np.stack(np.split(self.acting.displacement(coefficients)[self.field.acts], len(units), axis=1))

        displaced = by_unit(values)
        size = np.sqrt(np.mean(np.sum(displaced**2, axis=2), axis=1))
        products = [np.sum(by_unit(one) * displaced, axis=(1, 2)) for one in np.eye(len(values))]
        slopes = np.array(products) / (np.maximum(size, np.finfo(float).tiny) * displaced.shape[1])
        sigma = np.sqrt(np.einsum("cu,cd,du->u", slopes, covariance, slopes))
        clearest = int(np.argmax(size / np.maximum(sigma, np.finfo(float).tiny)))
        return float(size[clearest]), float(sigma[clearest]), units[clearest]

    def in_bench(self, values: FloatArray, covariance: FloatArray) -> tuple[BenchEffect, ...]:
        """Return the effects of a bench that do the same; none where no bench file states such.

        Args:
            values: (c,) coefficients.
            covariance: (c, c) of them.
        """
        stated = self.acting.in_bench
        if stated is None:
            return ()
        # The bench's coefficients are linear in the field's.
        by_each = [stated(one) for one in np.eye(len(values))]
        effects = []
        for number, effect in enumerate(stated(values)):
            by_value = np.stack([_coefficients(each[number]) for each in by_each], axis=1)
            effects.append(replace(effect, covariance=by_value @ covariance @ by_value.T))
        return tuple(effects)


def _coefficients(effect: BenchEffect) -> FloatArray:
    """Return the coefficients (p,) of an effect that a field states, row by row."""
    assert not isinstance(effect.function, AnyFunction)
    return effect.function.coefficients.ravel()
