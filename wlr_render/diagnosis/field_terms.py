"""Fields as sums of smooth functions of a station's coordinates, and the effects that they locate."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import scipy

from wlr_render.bench.bench_effects import AnyFunction, BenchEffect
from wlr_render.numerics.arrays import BoolArray, FloatArray, IntArray
from wlr_render.numerics.polynomial import Box, Polynomial, basis, total_degree
from wlr_render.numerics.waves import LocalWaves, Wave

ELSEWHERE = ("stage", "time")  # stations where a constant acts like a constant of the camera or the panel
_NEIGHBOURS = 4  # number of neighbours at the station with which each reading is compared
_WILD = 4.0  # sigma at which residuals are clipped
_IDLE = 1e-9  # rms of a column, in sigma, below which it has no effect


@dataclass(frozen=True, eq=False)
class StationField:
    """A displacement at a station as a sum of smooth functions, each with an unknown coefficient.

    Attributes:
        station: station at which it acts.
        coordinates: coordinates of the station on which the displacement depends.
        form: kind of displacement, for reports.
        columns: (n, 2, c) change of each reading by each function, in units of sigma; rms 1 over the readings.
        order: (c,) order of each function; a field of lower degree has the functions up to that order.
        degrees: degrees to try, ascending.
        place: (n, v) coordinates of each reading.
        acts: (n,) mask of the readings on which the field acts.
        unit: unit of the displacement.
        displacement: coefficients (c,) -> (n, d) displacement in the unit.
        in_bench: coefficients (c,) -> bench effects that do the same; None where no bench file can state them.
        is_in_spot: whether the field is zero outside a spot of its station.
        period: period of a wave along one coordinate, in the coordinate's unit; 0 for other fields.
        alternatives: number of similar fields from which the readings chose this one; its evidence is penalised by it.
    """

    station: str
    coordinates: str
    form: str
    columns: FloatArray
    order: IntArray
    degrees: tuple[int, ...]
    place: FloatArray
    acts: BoolArray
    unit: str
    displacement: Callable[[FloatArray], FloatArray]
    in_bench: Callable[[FloatArray], tuple[BenchEffect, ...]] | None = None
    period: float = 0.0
    alternatives: int = 1
    is_in_spot: bool = False

    @property
    def kind(self) -> tuple[str, str, str]:
        """Station, coordinates and form, which identify a field of a session."""
        return self.station, self.coordinates, self.form

    def counting(self, degree: int, above: int = -1) -> BoolArray:
        """Return a mask (c,) of the functions of order above `above` and up to `degree`."""
        return np.asarray((self.order <= degree) & (self.order > above))

    def selected(self, which: BoolArray, size: FloatArray | float = 1.0) -> "StationField":
        """Return the field with only the functions in a mask (c,), each divided by its size (c,)."""
        per, of_all = np.broadcast_to(size, len(which))[which], self.in_bench

        def every(values: FloatArray) -> FloatArray:
            spread = np.zeros(len(which))
            spread[which] = values / per
            return spread

        return replace(
            self,
            columns=self.columns[:, :, which] / per,
            order=self.order[which],
            displacement=lambda values: self.displacement(every(values)),
            in_bench=None if of_all is None else lambda values: of_all(every(values)),
        )


@dataclass(frozen=True, eq=False)
class Terms:
    """Smooth functions of coordinates.

    Attributes:
        coordinates: name of the coordinates.
        place: (n, v) coordinates of each reading.
        values: (n, t) values of the functions.
        order: (t,) order of each function.
        degrees: degrees to try, ascending.
        stated: the functions in the form of bench effects, with one output per function; the same for each copy.
        copies: attributes of a bench effect that limit each copy of the functions to some readings.
        means: (t,) constant that was subtracted from each function.
    """

    coordinates: str
    place: FloatArray
    values: FloatArray
    order: IntArray
    degrees: tuple[int, ...]
    stated: tuple[Polynomial | LocalWaves | Wave, ...]
    copies: tuple[Mapping[str, Any], ...] = ({},)
    means: FloatArray | None = None

    def varying(self) -> "Terms":
        """Return the functions minus their means; the constant, of order 0, stays."""
        means = np.where(self.order > 0, self.values.mean(axis=0), 0.0)
        return replace(self, values=self.values - means, means=means)

    def for_each(self, limit: str, numbers: IntArray) -> "Terms":
        """Return copies of the functions, each limited to the readings with one value of `numbers` (n,)."""
        values = np.unique(numbers)
        copies = np.concatenate([self.values * (numbers == each)[:, None] for each in values], axis=1)
        limits = tuple({limit: int(each)} for each in values)
        return replace(self, values=copies, order=np.tile(self.order, len(values)), copies=limits)

    def effects(self, station: str, displaces: str, coefficients: FloatArray) -> tuple[BenchEffect, ...]:
        """Return the bench effects for coefficients (t, k) of the functions; each copy has its limits."""
        if self.means is not None:
            coefficients = coefficients - np.outer(self.order == 0, self.means @ coefficients)
        ends = np.cumsum([len(each.coefficients) for each in self.stated])[:-1]
        return tuple(
            BenchEffect(station, displaces, replace(function, coefficients=part), **limits)
            for of_copy, limits in zip(np.split(coefficients, len(self.copies)), self.copies, strict=True)
            for function, part in zip(self.stated, np.split(of_copy, ends), strict=True)
        )


def smooth_terms(coordinates: str, variables: FloatArray, *degrees: int, orders: IntArray | None = None) -> Terms:
    """Return polynomials of the variables (n, v), up to the last degree or of the given orders (t, v)."""
    orders = total_degree(variables.shape[1], degrees[-1]) if orders is None else orders
    stated = polynomials(orders, Box.around(variables))
    values = basis(variables, orders, stated.box)
    return Terms(coordinates, variables, values, np.asarray(orders.sum(axis=1)), degrees, (stated,))


def polynomials(orders: IntArray, box: Box) -> Polynomial:
    """Return a function with one output per row of orders (t, v): the polynomial of these orders."""
    return Polynomial(orders, box, np.eye(len(orders)))


def field_of(
    station: str,
    form: str,
    unit: str,
    terms: Terms,
    lever: FloatArray,
    rows: BoolArray,
    displaces: str = "",
    axes: FloatArray | None = None,
) -> StationField:
    """Return a field of terms at some of the readings, each acting through all components of a lever.

    Args:
        station, form, unit: as in `StationField`.
        terms: terms at these readings (m,).
        lever: (m, 2, k) change of the readings in sigma per unit; (m, 2, t, k) if it differs between functions.
        rows: mask (n,) of these readings.
        displaces: `displaces` of the bench effect with the same action at that station; empty without one.
        axes: (k, d) components in the displacement of that effect; default: the same components.
    """
    count, components = len(lever), lever.shape[-1]
    by_term = lever if lever.ndim == 4 else lever[:, :, None, :] * terms.values[:, None, :, None]
    along = np.eye(components) if axes is None else axes

    def displacement(values: FloatArray) -> FloatArray:
        return over_rows(rows, terms.values @ values.reshape(-1, components))

    def in_bench(values: FloatArray) -> tuple[BenchEffect, ...]:
        return terms.effects(station, displaces, values.reshape(-1, components) @ along)

    acts = over_rows(rows, np.any(terms.values != 0.0, axis=1)) > 0.0
    field = StationField(
        station,
        terms.coordinates,
        form,
        over_rows(rows, by_term.reshape(count, 2, -1)),
        np.repeat(terms.order, components),
        terms.degrees,
        over_rows(rows, terms.place),
        acts,
        unit,
        displacement,
        in_bench if displaces else None,
    )
    size = np.sqrt(np.mean(field.columns**2, axis=(0, 1)))
    moving = field.selected(np.isfinite(size) & (size > _IDLE), size)
    highest = int(moving.order.max(initial=0))
    return replace(moving, degrees=tuple(each for each in field.degrees if each < highest) + (highest,))


@dataclass(frozen=True, eq=False)
class LocatedEffect:
    """A field that the readings show.

    Attributes:
        field: the field: where and how it acts.
        degree: highest order of its functions.
        above: order above which its functions are used; functions up to it belong to another effect. -1 for all.
        size: most probable size of its coefficients, in units of sigma.
        log10_odds: log10 odds for the effect against no effect, given the known causes and effects.
        next_station: the station with the next best evidence; empty without one.
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
        """Return the same effect on other readings, given the fields of these readings."""
        return replace(self, field=next(each for each in fields if each.kind == self.field.kind))

    @cached_property
    def acting(self) -> StationField:
        """The field with only the functions of this effect."""
        return self.field.selected(self.field.counting(self.degree, self.above))

    def size_of(self, values: FloatArray, covariance: FloatArray) -> tuple[float, float, str]:
        """Return the rms displacement over the readings on which the field acts, its standard error and its unit.

        For a field of shifts and turns, return the one with the larger ratio to its error.

        Args:
            values: (c,) coefficients.
            covariance: (c, c) covariance of the coefficients.
        """
        units = self.field.unit.split(", ")
        if self.field.period:  # the constant term is not part of the wave
            varies = self.acting.order > 0
            values, covariance = values * varies, covariance * np.outer(varies, varies)

        def by_unit(coefficients: FloatArray) -> FloatArray:
            """Return the displacement (units, n, k), split by unit."""
            return np.stack(np.split(self.acting.displacement(coefficients)[self.field.acts], len(units), axis=1))

        displaced = by_unit(values)
        size = np.sqrt(np.mean(np.sum(displaced**2, axis=2), axis=1))
        products = [np.sum(by_unit(one) * displaced, axis=(1, 2)) for one in np.eye(len(values))]
        slopes = np.array(products) / (np.maximum(size, np.finfo(float).tiny) * displaced.shape[1])
        sigma = np.sqrt(np.einsum("cu,cd,du->u", slopes, covariance, slopes))
        clearest = int(np.argmax(size / np.maximum(sigma, np.finfo(float).tiny)))
        return float(size[clearest]), float(sigma[clearest]), units[clearest]

    def in_bench(self, values: FloatArray, covariance: FloatArray) -> tuple[BenchEffect, ...]:
        """Return the bench effects that do the same; empty where no bench file can state them.

        Args:
            values: (c,) coefficients.
            covariance: (c, c) covariance of the coefficients.
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
    """Return the coefficients (p,) of a field's bench effect, flattened row by row."""
    assert not isinstance(effect.function, AnyFunction)
    return effect.function.coefficients.ravel()


def neighbours_agree(field: StationField, left: FloatArray, standard_errors: float) -> bool:
    """Return whether residuals of neighbouring readings at a station correlate.

    Args:
        field: field with constant functions, which give the change of each reading by a displacement.
        left: (n, 2) residual of the readings, in units of sigma.
        standard_errors: significance above which a mean product of neighbours is not due to chance.
    """
    rows = np.flatnonzero(field.acts)
    place = field.place[rows] / np.maximum(field.place[rows].std(axis=0), np.finfo(float).tiny)
    near = scipy.spatial.KDTree(place).query(place, min(_NEIGHBOURS + 1, len(rows)))[1][:, 1:]
    for column in np.moveaxis(field.columns[rows][:, :, field.order == 0], 2, 0):
        along = np.sum(left[rows] * column, axis=1) / np.maximum(np.linalg.norm(column, axis=1), _IDLE)
        along = np.clip(along / np.sqrt(np.mean(along**2)), -_WILD, _WILD)
        products = along[:, None] * along[near]
        if products.sum() > standard_errors * np.sqrt(np.sum(products**2)):
            return True
    return False


def over_rows(mask: BoolArray, values: FloatArray, elsewhere: float = 0.0) -> FloatArray:
    """Return an array over all readings (n, ...): `values` (m, ...) in the mask (n,), and `elsewhere` outside it."""
    full = np.full((len(mask), *values.shape[1:]), elsewhere)
    full[mask] = values
    return full
