"""Outliers among captures: photographs not taken at the stated position, and dots measured beside their place.

A fit finds the motion of the camera in each capture, and leaves out those that stand out from the others
(`smooth_search`).

Through the optics every dot is displaced from the straight line to it by an amount that varies smoothly over a
photograph. A dot is an outlier if it does not follow that smooth field, or if its stated sigma is far above the
others', as that of a dot cut by an aperture's edge is.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wlr_render.calibration.fit_display import fit_display
from wlr_render.calibration.fit_report import AnyModel, ModelFit
from wlr_render.calibration.fit_see_through import fit_see_through
from wlr_render.captures.correspondences import AnyCaptures, DisplayCaptures, SeeThroughCaptures, select
from wlr_render.errors import BadInputError
from wlr_render.geometry.directions import ARCMIN, tangents_of_dir
from wlr_render.numerics.arrays import BoolArray, FloatArray, IntArray
from wlr_render.numerics.polynomial import Box, basis, term_count, total_degree

_ROWS = 150  # of a capture that take part: a motion needs no more
_DEGREE = 4  # optics that follow a capture far off hide it
_LEAST_ARCMIN = 2.0  # an error below it spoils no model

_DOT_TOP_DEGREE = 4  # highest degree of the field of a photograph's dots: a misread dot is off by itself
_DOTS_PER_TERM = 8  # fewest dots for each term, so that an outlier among them bends the field little
_DOT_SIGMAS, _DOT_LEAST_ARCMIN = 8.0, 0.3
"""An outlier is off by more than both: by what neither noise nor a field of higher degree leaves, and by a third of a
camera pixel of 1', below which a dot is noisy but not misread."""
_DOT_SIGMA_RATIO = 5.0  # largest sigma over the median of the photograph's dots: dots beyond it are cut or blurred
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
    return _outliers(captures, captures.capture, fit_display)


def see_through_outliers(captures: SeeThroughCaptures, photograph: IntArray) -> list[CaptureOutlier]:
    """Return photographs of the target that contradict the others; (n,) `photograph` numbers each row's."""
    return _outliers(captures, photograph, fit_see_through)


def _outliers(
    captures: AnyCaptures, group: IntArray, fit: Callable[[AnyCaptures, str, int | None], ModelFit[AnyModel]]
) -> list[CaptureOutlier]:
    """Return the captures that a fit finds far from where they are said to be, if their error is one that matters."""
    names = np.unique(group)
    rows = np.concatenate(
        [own[:: max(1, len(own) // _ROWS)] for own in (np.flatnonzero(group == name) for name in names)]
    )
    try:
        smooth = fit(select(captures, rows), "planar", _DEGREE).smooth
    except BadInputError:
        return []  # so says the fit of all of them
    found = [(int(group[rows][smooth.readings.capture == each.capture][0]), each.arcmin) for each in smooth.moved]
    return [CaptureOutlier(name, arcmin) for name, arcmin in sorted(found) if arcmin > _LEAST_ARCMIN]


def dot_inliers(captures: SeeThroughCaptures, photograph: NDArray[np.int64]) -> BoolArray:
    """Return a mask (n,) of dots that follow the smooth field of their photograph, numbered by `photograph` (n,)."""
    seen = captures.tangents
    displaced = (seen - tangents_of_dir(captures.point - captures.viewpoint)) / ARCMIN
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
