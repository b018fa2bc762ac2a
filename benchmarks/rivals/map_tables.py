"""One map for each camera position, interpolated between the positions: tables, and principal components.

Headsets ship tables with interpolation (US 10,373,297; US 10,241,545). Principal components of the maps, with scores
that depend on the eye's position, are from Guan et al., "Perceptual requirements for eye-tracked distortion correction
in VR", SIGGRAPH 2022; according to its abstract, their maps are traced through a prescription.
"""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
from scipy.interpolate import RBFInterpolator
from scipy.spatial import Delaunay

from benchmarks.rivals.numeric_regressor import NumericRegressor
from benchmarks.rivals.samples import FOLDS, Samples, least_squares
from wlr_render.errors import BadInputError
from wlr_render.numerics.arrays import FloatArray, IntArray
from wlr_render.numerics.polynomial import Box, Polynomial, basis, term_count, total_degree

_MAP_DEGREES = (4, 6, 8)  # degrees of one position's polynomial map, chosen by held-out readings
_CONSTANT = 1e-6  # largest variation of a position's place over the extent of all places
_DEPTHS_APART = 0.3  # smallest spread of inverse depths over the largest; a tilted target reaches 0.2
_COMPONENTS = (2, 3, 4, 6, 8, 10, 14, 18)
_SCORE_DEGREES = (2, 3, 4, 5, 6)
_STEPS_INWARD = 60
_INWARD = 0.97  # factor on the distance from the centre, per step


@dataclass(frozen=True, eq=False)
class PositionMaps:
    """The map of each of k camera positions: polynomials of the pixel (px) or of the view tangents.

    Attributes:
        samples: samples to which the maps are fitted.
        orders: (terms, 2) orders of the polynomials.
        box: box of the two inputs of the polynomials.
        coefficients: (k, terms, outputs).
        place: (k, place variables) places of the positions, scaled to -1..1.
    """

    samples: Samples
    orders: IntArray
    box: Box
    coefficients: FloatArray
    place: FloatArray

    @classmethod
    def of(cls, samples: Samples) -> "PositionMaps":
        """Fit each map by least squares, all with the degree of least error at held-out readings.

        Raises:
            BadInputError: a position's place is not one point, or it has too few readings.
        """
        fewest = np.bincount(samples.position).min() * 0.8 / samples.readings.blocks
        known = [each for each in _MAP_DEGREES if term_count(2, each) < fewest] or [2]
        degree = known[0]
        if len(known) > 1:
            degree = min(known, key=lambda each: _held_out_map_error(samples, each))
        subject = samples.readings.inputs[:, ~samples.is_place]
        box = samples.readings.box.select(np.flatnonzero(~samples.is_place).tolist())
        orders = total_degree(2, degree)
        phi, columns = basis(subject, orders, box), samples.readings.blocks * len(orders)
        coefficients, places = [], []
        for position in range(int(samples.position.max()) + 1):
            rows = np.flatnonzero(samples.position == position)
            _require_two_depths(samples, rows, position)
            if len(rows) < columns:
                raise BadInputError(
                    f"camera position {position} has {len(rows)} readings, too few for its own map; "
                    f"a table needs {columns} or more at each."
                )
            coefficients.append(samples.solve(phi[rows], rows))
            place = samples.scaled[rows][:, samples.is_place]
            if place.size and np.ptp(place, axis=0).max() > _CONSTANT:
                raise BadInputError(
                    "the camera positions do not lie in the base plane, so that a position's rays cross it at many "
                    "points; a table needs one place for each map: take positions in one plane."
                )
            places.append(place[0])
        return cls(samples, orders, box, np.array(coefficients), np.array(places))

    def metric_root(self) -> FloatArray:
        """Return an upper triangular matrix (m, m) whose product with a map (m, 2) has the map's rms size in readings.

        m is the number of blocks times the number of terms, as in `Samples.by_column`.
        """
        samples = self.samples
        phi = basis(samples.readings.inputs[:, ~samples.is_place], self.orders, self.box)
        return np.asarray(np.linalg.qr(samples.design(phi) / np.sqrt(len(samples)), mode="r"))

    def regressor(self, weights: Callable[[FloatArray], FloatArray], coefficients: FloatArray) -> NumericRegressor:
        """Sum maps (c, terms, outputs) over c with weights (n, c) at scaled places (n, place variables)."""
        samples, flat = self.samples, coefficients.reshape(len(coefficients), -1)
        box, is_place = samples.readings.box, samples.is_place

        def value(inputs: FloatArray) -> FloatArray:
            mixed = (weights(box.scaled(inputs)[:, is_place]) @ flat).reshape(len(inputs), len(self.orders), -1)
            return np.asarray(np.einsum("nt,nto->no", basis(inputs[:, ~is_place], self.orders, self.box), mixed))

        return NumericRegressor(value, box, samples.outputs, numbers=coefficients.size)

    def table(
        self, fewest: int, interpolate: Callable[[FloatArray], Callable[[FloatArray], FloatArray]]
    ) -> NumericRegressor:
        """Interpolate the maps between their places; a single map, or a map without places, serves all viewpoints.

        Args:
            fewest: number of positions that the interpolation needs.
            interpolate: function of k places that returns a function of n places, which returns weights (n, k).

        Raises:
            BadInputError: there are fewer positions, or they do not span the places.
        """
        if len(self.place) == 1 or self.place.shape[1] == 0:
            return self.regressor(lambda place: np.ones((len(place), 1)), self.coefficients[:1])
        _require_places(self.place, fewest)
        return self.regressor(interpolate(self.place), self.coefficients)


def _held_out_map_error(samples: Samples, degree: int) -> float:
    """Return the sum of squares at every fifth reading of each position for maps fitted to the other readings."""
    subject = samples.readings.inputs[:, ~samples.is_place]
    phi = basis(
        subject, total_degree(2, degree), samples.readings.box.select(np.flatnonzero(~samples.is_place).tolist())
    )
    target, error = samples.target(), 0.0
    out = np.random.default_rng(0).permutation(len(samples)) % FOLDS == 0
    for position in range(int(samples.position.max()) + 1):
        here = samples.position == position
        kept, left = np.flatnonzero(here & ~out), np.flatnonzero(here & out)
        solution = samples.by_column(samples.solve(phi[kept], kept))
        error += float(np.sum((samples.design(phi[left], left) @ solution - target[left]) ** 2))
    return error


def linear_table(samples: Samples) -> NumericRegressor:
    """Fit maps, interpolated linearly within the Delaunay triangles (tetrahedra) of their places; clamped to the hull.

    Raises:
        BadInputError: see `PositionMaps.of` and `PositionMaps.table`.
    """
    maps = PositionMaps.of(samples)
    return maps.table(maps.place.shape[1] + 1, _linear_weights)


def thin_plate_table(samples: Samples) -> NumericRegressor:
    """Fit maps, interpolated by thin-plate splines of their places.

    Raises:
        BadInputError: see `PositionMaps.of` and `PositionMaps.table`.
    """
    maps = PositionMaps.of(samples)
    variables = maps.place.shape[1]
    degree = 2 if len(maps.place) > 2 * term_count(variables, 2) else 1

    def spline(place: FloatArray) -> RBFInterpolator:
        return RBFInterpolator(place, np.eye(len(place)), kernel="thin_plate_spline", degree=degree)

    return maps.table(term_count(variables, degree), spline)


FitScores = Callable[[FloatArray, FloatArray, Any], tuple[Callable[[FloatArray], FloatArray], int]]
"""(places (k, variables), scores (k, count), setting) -> function of places, and number of numbers that it stores."""


def principal_components(samples: Samples) -> NumericRegressor:
    """Fit the mean map and principal components, with scores that are polynomials of the place.

    The number of components and the degree are those with the least error at held-out positions.
    """
    return components_with_scores(samples, _COMPONENTS, _SCORE_DEGREES, _polynomial_scores)


def components_with_scores(
    samples: Samples, counts: Sequence[int], settings: Sequence[Any], fit: FitScores
) -> NumericRegressor:
    """Fit the mean map and principal components, with scores that are a function of the place.

    Args:
        samples: samples to fit.
        counts: numbers of components, chosen by the error at held-out positions.
        settings: settings of `fit`, chosen likewise.
        fit: function that fits the scores; it raises BadInputError for a setting that needs more positions.

    Raises:
        BadInputError: too few camera positions.
    """
    maps = PositionMaps.of(samples)
    if maps.place.shape[1] == 0:
        return linear_table(samples)
    root = maps.metric_root()
    by_column = np.stack([samples.by_column(each) for each in maps.coefficients])
    size = np.einsum("ij,kjo->kio", root, by_column).reshape(len(maps.place), -1)  # rms size in the readings
    fold = np.random.default_rng(0).permutation(len(size)) % FOLDS

    def error(count: int, setting: Any) -> float:
        total = 0.0
        for number in range(FOLDS):
            components = _Components.of(maps.place[fold != number], size[fold != number], count, setting, fit)
            total += float(np.sum((components.maps(maps.place[fold == number]) - size[fold == number]) ** 2))
        return total

    choices = {}
    for count, setting in product([each for each in counts if each < 0.8 * len(size) - 1], settings):
        with suppress(BadInputError):
            choices[count, setting] = error(count, setting)
    if not choices:
        raise BadInputError(
            f"{len(size)} camera positions are too few for principal components; take 9 or more in a plane, 13 or more "
            "in a volume."
        )
    found = _Components.of(maps.place, size, *min(choices, key=lambda each: choices[each]), fit)
    seen = np.concatenate([found.mean[None], found.axes]).reshape(-1, *by_column.shape[1:])
    every = np.stack([samples.by_block(np.linalg.solve(root, each)) for each in seen])
    regressor = maps.regressor(found.weights, every)
    return replace(regressor, numbers=every.size + found.numbers)


def _polynomial_scores(place: FloatArray, scores: FloatArray, degree: int) -> tuple[Polynomial, int]:
    if term_count(place.shape[1], degree) > len(place):
        raise BadInputError(f"{len(place)} camera positions are too few for scores of degree {degree}.")
    orders, box = total_degree(place.shape[1], degree), Box(-np.ones(place.shape[1]), np.ones(place.shape[1]))
    fitted = Polynomial(orders, box, least_squares(basis(place, orders, box), scores))
    return fitted, fitted.coefficients.size


@dataclass(frozen=True, eq=False)
class _Components:
    """A map as mean (m,) + scores(place) @ axes (count, m), and the number of numbers that the scores store."""

    mean: FloatArray
    axes: FloatArray
    scores: Callable[[FloatArray], FloatArray]
    numbers: int

    @classmethod
    def of(cls, place: FloatArray, rows: FloatArray, count: int, setting: Any, fit: FitScores) -> "_Components":
        mean = rows.mean(axis=0)
        left, size, axes = np.linalg.svd(rows - mean, full_matrices=False)
        return cls(mean, axes[:count], *fit(place, (left * size)[:, :count], setting))

    def weights(self, place: FloatArray) -> FloatArray:
        """Return the weights of the mean and the axes, (n, 1 + count)."""
        return np.hstack([np.ones((len(place), 1)), self.scores(place)])

    def maps(self, place: FloatArray) -> FloatArray:
        """Return the maps (n, m) at places."""
        return self.mean + self.scores(place) @ self.axes


def _require_two_depths(samples: Samples, rows: IntArray, position: int) -> None:
    """Refuse see-through readings of one position with all real points at about the same distance."""
    if samples.readings.blocks == 1:
        return
    inverse = samples.readings.multiplier[rows, 1]
    if np.ptp(inverse) < _DEPTHS_APART * np.abs(inverse).max():
        near, far = np.sort(1.0 / inverse[[np.argmax(inverse), np.argmin(inverse)]])
        raise BadInputError(
            f"camera position {position} saw real points from {near:.2f} to {far:.2f} m only, so its own map for "
            "near and far points is not determined; a table needs a nearer and a farther target at each position."
        )


def _require_places(place: FloatArray, fewest: int) -> None:
    variables = place.shape[1]
    if len(place) < fewest or np.linalg.matrix_rank(place - place.mean(axis=0), tol=1e-3) < variables:
        raise BadInputError(
            f"{len(place)} camera positions do not span {variables} dimensions of places; take {fewest} or more, not "
            f"all in one {'line' if variables == 2 else 'plane'}."
        )


def _linear_weights(place: FloatArray) -> Callable[[FloatArray], FloatArray]:
    """Return a function from places (m, place variables) to weights (m, k) of k places, clamped to their hull."""
    simplices, centre, variables = Delaunay(place), place.mean(axis=0), place.shape[1]

    def weights(wanted: FloatArray) -> FloatArray:
        point = np.where(np.isfinite(wanted), wanted, centre)
        index = simplices.find_simplex(point)
        for _ in range(_STEPS_INWARD):
            outside = index < 0
            if not outside.any():
                break
            point = np.where(outside[:, None], centre + _INWARD * (point - centre), point)
            index[outside] = simplices.find_simplex(point[outside])
        transform = simplices.transform[index]
        first = np.einsum("nij,nj->ni", transform[:, :variables], point - transform[:, variables])
        found = np.zeros((len(point), len(place)))
        np.put_along_axis(found, simplices.simplices[index], np.column_stack([first, 1.0 - first.sum(axis=1)]), axis=1)
        return found

    return weights
