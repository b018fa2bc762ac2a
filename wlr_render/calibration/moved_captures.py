"""Captures that were not taken where they are said to have been: exchanged, mislabelled, or after something moved.

Each capture in turn is predicted by a model of low degree that is fitted to the others. What such a model cannot follow
swings about over the field; a camera that stood elsewhere shifts all that it saw one way. So the mean error tells.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from wlr_render.calibration.fit_display import display_of_degree
from wlr_render.calibration.fit_see_through import see_through_of_degree
from wlr_render.captures.correspondences import AnyCaptures, DisplayCaptures, SeeThroughCaptures, select
from wlr_render.geometry.directions import ARCMIN, tangents_of_dir
from wlr_render.numerics.arrays import FloatArray, IntArray
from wlr_render.numerics.polynomial import term_count

_ROWS = 150  # of a capture that take part: a mean needs no more
_SPARE = 2.0  # times as many places as the model has terms in them must be left
_TOP_DEGREE = 3
_TIMES_USUAL, _LEAST_ARCMIN = 6.0, 2.0  # an error above both is not of the model's making
_SUSPICIOUS = 3.0  # times the usual one
_MOST = 0.2  # of the captures that may be off; where more are, it is the model that is


@dataclass(frozen=True)
class Moved:
    """A capture that is off.

    Attributes:
        group: the number by which it was grouped.
        arcmin: by how much, on average over all it saw.
    """

    group: int
    arcmin: float


def moved_display(captures: DisplayCaptures) -> list[Moved]:
    """Captures of the panel that do not fit the others; none where there are too few to tell."""

    def errors(kept: DisplayCaptures, left_out: DisplayCaptures, degree: int) -> FloatArray:
        model = display_of_degree(kept, "planar", degree)
        return model.view_dir_of_pixel(left_out.pixel, left_out.viewpoint).value

    return _moved(captures, captures.capture, errors)


def moved_see_through(captures: SeeThroughCaptures, photograph: IntArray) -> list[Moved]:
    """Photographs of the target that do not fit the others; (n,) `photograph` numbers each row's."""

    def errors(kept: SeeThroughCaptures, left_out: SeeThroughCaptures, degree: int) -> FloatArray:
        model = see_through_of_degree(kept, "planar", degree)
        return model.view_dir_of_real_point(left_out.point, left_out.viewpoint).value

    return _moved(captures, photograph, errors)


def _moved(
    captures: AnyCaptures, group: IntArray, predict: Callable[[AnyCaptures, AnyCaptures, int], FloatArray]
) -> list[Moved]:
    """Suspects are put aside one by one, since each spoils the prediction of the others; then those left judge them."""
    names = [int(name) for name in np.unique(group)]
    rows = np.concatenate([_spread(np.flatnonzero(group == name)) for name in names])
    thinned, of = select(captures, rows), group[rows]
    suspects: list[int] = []
    while len(suspects) <= _MOST * len(names):
        left = [name for name in names if name not in suspects]
        degree = _degree(len(np.unique(thinned.viewpoint[np.isin(of, left)], axis=0)) - 1)
        if degree == 0:
            return []
        found_errors = [_mean_error(thinned, of, name, left, degree, predict) for name in left]
        usual, worst = float(np.median(found_errors)), int(np.argmax(found_errors))
        if found_errors[worst] < max(_SUSPICIOUS * usual, _LEAST_ARCMIN):
            found = [Moved(name, _mean_error(thinned, of, name, left, degree, predict)) for name in suspects]
            return [each for each in found if each.arcmin > max(_TIMES_USUAL * usual, _LEAST_ARCMIN)]
        suspects.append(left[worst])
    return []


def _mean_error(
    captures: AnyCaptures,
    group: IntArray,
    name: int,
    left: Sequence[int],
    degree: int,
    predict: Callable[[AnyCaptures, AnyCaptures, int], FloatArray],
) -> float:
    """Length of the mean error of one capture, predicted by the others, arcminutes."""
    others, own = np.isin(group, left) & (group != name), group == name
    predicted = predict(select(captures, others), select(captures, own), degree)
    apart = tangents_of_dir(captures.view_dir[own]) - tangents_of_dir(predicted)
    apart = apart[np.isfinite(apart).all(axis=1)]
    if len(apart) == 0:
        return float("inf")
    return float(np.linalg.norm(apart.mean(axis=0))) / ARCMIN  # a mean, since model error averages out of it


def _degree(places: int) -> int:
    """The highest degree that so many places determine with some to spare; 0 if none."""
    fit = [degree for degree in range(1, _TOP_DEGREE + 1) if _SPARE * term_count(2, degree) <= places]
    return fit[-1] if fit else 0


def _spread(rows: IntArray) -> IntArray:
    return rows[:: max(1, len(rows) // _ROWS)]
