"""Fields as sums of smooth functions of a station's coordinates, each with its column of changes of the readings."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial import KDTree

from wlr_render.bench.bench_effects import BenchEffect
from wlr_render.diagnosis.cause import Cause
from wlr_render.diagnosis.prediction import Hypothesis, Predictor
from wlr_render.numerics.arrays import BoolArray, FloatArray, IntArray
from wlr_render.numerics.polynomial import Box, Polynomial, basis, total_degree
from wlr_render.numerics.waves import LocalWaves, Wave

ELSEWHERE = ("stage", "time")  # stations at which a constant acts like one of the camera or of the panel
_NEIGHBOURS = 4  # neighbours of a reading at its station that are compared with it
_WILD = 4.0  # sigma; a reading counts no more than this
_IDLE = 1e-9  # rms of a column in sigma below which it does nothing


@dataclass(frozen=True, eq=False)
class StationField:
    """A displacement at a station as a sum of smooth functions, each with an unknown coefficient.

    Attributes:
        station: station at which it acts.
        coordinates: coordinates of the station on which the displacement depends.
        form: kind of displacement, for reports.
        columns: (n, 2, c) change of each reading by each function, in units of sigma; rms 1 over the readings.
        order: (c,) order of each function; a field of lower degree has those up to it.
        degrees: that are tried, ascending.
        place: (n, v) coordinates of each reading; those in `acts` (n,) feel the field.
        unit: of the displacement.
        displacement: coefficients (c,) -> (n, d) displacement in the unit.
        in_bench: coefficients (c,) -> effects of a bench that do the same; None where no bench file can state them.
        is_in_spot: whether it is zero outside a spot of its station.
        period: of a wave along one coordinate, in the coordinate's unit; 0 for others.
        alternatives: number of such fields of which the readings chose this one; its evidence is charged for them.
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
        """Return a mask (c,) of the functions of order up to `degree` and beyond `above`."""
        return np.asarray((self.order <= degree) & (self.order > above))

    def selected(self, which: BoolArray, size: FloatArray | float = 1.0) -> "StationField":
        """Return the field of the functions in a mask (c,), each divided by its size (c,)."""
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
        coordinates: their name.
        place: (n, v) coordinates of each reading.
        values: (n, t) functions. order: (t,) of each.
        degrees: that are tried, ascending.
        stated: these functions in turn, as effects of a bench state them; of each of `copies`. One output for each.
        copies: attributes of a bench's effect that limit each copy of the functions to some readings.
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
        """Return the functions less their means, except a constant, of order 0."""
        means = np.where(self.order > 0, self.values.mean(axis=0), 0.0)
        return replace(self, values=self.values - means, means=means)

    def for_each(self, limit: str, numbers: IntArray) -> "Terms":
        """Return copies of the functions, one for each value of the numbers (n,) by which effects are limited."""
        values = np.unique(numbers)
        copies = np.concatenate([self.values * (numbers == each)[:, None] for each in values], axis=1)
        limits = tuple({limit: int(each)} for each in values)
        return replace(self, values=copies, order=np.tile(self.order, len(values)), copies=limits)

    def effects(self, station: str, displaces: str, coefficients: FloatArray) -> tuple[BenchEffect, ...]:
        """Return effects of a bench by coefficients (t, k) of the functions, for each copy with its limits."""
        if self.means is not None:
            coefficients = coefficients - np.outer(self.order == 0, self.means @ coefficients)
        ends = np.cumsum([len(each.coefficients) for each in self.stated])[:-1]
        return tuple(
            BenchEffect(station, displaces, replace(function, coefficients=part), **limits)
            for of_copy, limits in zip(np.split(coefficients, len(self.copies)), self.copies, strict=True)
            for function, part in zip(self.stated, np.split(of_copy, ends), strict=True)
        )


def smooth_terms(coordinates: str, variables: FloatArray, *degrees: int, orders: IntArray | None = None) -> Terms:
    """Return the polynomials of variables (n, v) up to the last of the degrees, or of the given orders (t, v)."""
    orders = total_degree(variables.shape[1], degrees[-1]) if orders is None else orders
    stated = polynomials(orders, Box.around(variables))
    values = basis(variables, orders, stated.box)
    return Terms(coordinates, variables, values, np.asarray(orders.sum(axis=1)), degrees, (stated,))


def polynomials(orders: IntArray, box: Box) -> Polynomial:
    """Return one polynomial for each row of orders (t, v), as outputs of a function."""
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
        terms: at these readings (m,).
        lever: (m, 2, k) sigma per unit; (m, 2, t, k) where it is another one for each function.
        rows: mask (n,) of these readings.
        displaces: `displaces` of the bench effect with the same action at that station; empty without one.
        axes: (k, d) of the components in the displacement of that effect; the same components if not given.
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


def neighbours_agree(field: StationField, left: FloatArray, standard_errors: float) -> bool:
    """Return whether residuals of readings that are near each other at a station correlate.

    Args:
        field: its constant functions give the change of each reading by a displacement.
        left: (n, 2) residual of the readings, in units of sigma.
        standard_errors: significance beyond which a mean product of neighbours is not chance.
    """
    rows = np.flatnonzero(field.acts)
    place = field.place[rows] / np.maximum(field.place[rows].std(axis=0), np.finfo(float).tiny)
    near = KDTree(place).query(place, min(_NEIGHBOURS + 1, len(rows)))[1][:, 1:]
    for column in np.moveaxis(field.columns[rows][:, :, field.order == 0], 2, 0):
        along = np.sum(left[rows] * column, axis=1) / np.maximum(np.linalg.norm(column, axis=1), _IDLE)
        along = np.clip(along / np.sqrt(np.mean(along**2)), -_WILD, _WILD)
        products = along[:, None] * along[near]
        if products.sum() > standard_errors * np.sqrt(np.sum(products**2)):
            return True
    return False


def over_rows(mask: BoolArray, values: FloatArray, elsewhere: float = 0.0) -> FloatArray:
    """Return values (m, ...) of the readings in a mask (n,), and one value elsewhere."""
    full = np.full((len(mask), *values.shape[1:]), elsewhere)
    full[mask] = values
    return full


def lever_of(predictor: Predictor, cause: Cause) -> FloatArray:
    """Return the change (n, 2, k) of the readings, in sigma, by each parameter of a cause, at the nominal bench."""
    at = predictor.signature(Hypothesis(cause, next(iter(cause.variants))))
    lever = np.zeros((*at.residual.shape, len(cause.parameters)))
    lever[:, :, at.free] = at.jacobian
    return np.asarray(lever / at.explanation.prior_sigma)
