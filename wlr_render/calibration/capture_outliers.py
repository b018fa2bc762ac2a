"""Outliers among captures: photographs not taken at the stated position, and dots measured beside their place.

Each capture in turn is predicted by a model of low degree fitted to the others. Model errors oscillate over the field;
a camera that stood elsewhere shifts everything it saw in one direction. So the mean error is tested.

Through the optics every dot is displaced from the straight line to it by an amount that varies smoothly over a
photograph. A dot is an outlier if it does not follow that smooth field, or if its stated sigma is far above the
others', as that of a dot cut by an aperture's edge is.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wlr_render.calibration.fit_display import display_of_degree
from wlr_render.calibration.fit_see_through import see_through_of_degree
from wlr_render.captures.correspondences import AnyCaptures, DisplayCaptures, SeeThroughCaptures, select
from wlr_render.geometry.directions import ARCMIN, normalised, tangents_of_dir
from wlr_render.numerics.arrays import BoolArray, FloatArray, IntArray
from wlr_render.numerics.polynomial import Box, basis, term_count, total_degree

_ROWS = 150  # of a capture that take part: a mean needs no more
_SPARE = 2.0  # times as many places as the model has terms in them must be left
_TOP_DEGREE = 3
_TIMES_USUAL, _LEAST_ARCMIN = 6.0, 2.0  # an error above both is not of the model's making
_SUSPICIOUS = 3.0  # times the usual one
_MOST = 0.2  # of the captures that may be off; where more are, it is the model that is

_DOT_TOP_DEGREE = 4
_DOTS_PER_TERM = 8
_DOT_SIGMAS, _DOT_LEAST_ARCMIN = 8.0, 0.3  # an outlier is off by more than both
_DOT_SIGMA_RATIO = 5.0  # times the median standard deviation of the photograph's dots
_ROUNDS = 10  # outliers bend the field that they are judged by: the worst go first
_AT_ONCE = 3.0  # what is this much less off than the worst waits for the next round
_MAD = 1.4826  # median absolute deviation to standard deviation


@dataclass(frozen=True)
class CaptureOutlier:
    """A capture that contradicts the others.

    Attributes:
        group: the number by which it was grouped.
        arcmin: mean error over all it saw.
    """

    group: int
    arcmin: float


def display_outliers(captures: DisplayCaptures) -> list[CaptureOutlier]:
    """Return captures of the panel that contradict the others; none where there are too few to judge."""

    def errors(kept: DisplayCaptures, left_out: DisplayCaptures, degree: int) -> FloatArray:
        model = display_of_degree(kept, "planar", degree)
        return model.view_dir_of_pixel(left_out.pixel, left_out.viewpoint).value

    return _outliers(captures, captures.capture, errors)


def see_through_outliers(captures: SeeThroughCaptures, photograph: IntArray) -> list[CaptureOutlier]:
    """Return photographs of the target that contradict the others; (n,) `photograph` numbers each row's."""

    def errors(kept: SeeThroughCaptures, left_out: SeeThroughCaptures, degree: int) -> FloatArray:
        model = see_through_of_degree(kept, "planar", degree)
        return model.view_dir_of_real_point(left_out.point, left_out.viewpoint).value

    return _outliers(captures, photograph, errors)


def _outliers(
    captures: AnyCaptures, group: IntArray, predict: Callable[[AnyCaptures, AnyCaptures, int], FloatArray]
) -> list[CaptureOutlier]:
    """Remove suspects one by one, since each biases the prediction of the others; then test them against the rest."""
    names = [int(name) for name in np.unique(group)]
    rows = np.concatenate(
        [own[:: max(1, len(own) // _ROWS)] for own in (np.flatnonzero(group == name) for name in names)]
    )
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
            found = [CaptureOutlier(name, _mean_error(thinned, of, name, left, degree, predict)) for name in suspects]
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
    apart = captures.tangents[own] - tangents_of_dir(predicted)
    apart = apart[np.isfinite(apart).all(axis=1)]
    if len(apart) == 0:
        return float("inf")
    return float(np.linalg.norm(apart.mean(axis=0))) / ARCMIN  # a mean, since model error averages out of it


def _degree(places: int) -> int:
    """The highest degree that so many places determine with some to spare; 0 if none."""
    fit = [degree for degree in range(1, _TOP_DEGREE + 1) if _SPARE * term_count(2, degree) <= places]
    return fit[-1] if fit else 0


def dot_inliers(captures: SeeThroughCaptures, photograph: NDArray[np.int64]) -> BoolArray:
    """Return a mask (n,) of dots that follow the smooth field of their photograph, numbered by `photograph` (n,)."""
    straight = normalised(captures.point - captures.viewpoint)
    seen = captures.tangents
    displaced = (seen - tangents_of_dir(straight)) / ARCMIN
    follows = np.ones(len(captures), dtype=bool)
    for one in np.unique(photograph):
        rows = np.flatnonzero(photograph == one)
        sigma = captures.sigma_arcmin[rows]
        sure = rows[sigma <= _DOT_SIGMA_RATIO * np.median(sigma)]
        follows[rows] = False
        follows[sure] = _smooth(seen[sure], displaced[sure])
    return follows


def _smooth(place: FloatArray, displaced: FloatArray) -> BoolArray:
    """(n,) which of the values (n, 2) at places (n, 2) follow a polynomial through them."""
    kept = np.ones(len(place), dtype=bool)
    degree = next((n for n in range(_DOT_TOP_DEGREE, 0, -1) if term_count(2, n) * _DOTS_PER_TERM <= len(place)), 0)
    if degree == 0:
        return kept
    design = basis(place, total_degree(2, degree), Box.around(place))
    for _ in range(_ROUNDS):
        coefficients = np.linalg.lstsq(design[kept], displaced[kept], rcond=None)[0]
        off = np.linalg.norm(displaced - design @ coefficients, axis=1)
        limit = max(_DOT_SIGMAS * _MAD * float(np.median(off[kept])), _DOT_LEAST_ARCMIN)
        worst = float(off[kept].max())
        if worst <= limit:
            break
        kept = off <= max(limit, worst / _AT_ONCE)
    return kept
