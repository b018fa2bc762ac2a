"""Dots of the target that were found beside their place: cut by an aperture's edge, or half hidden.

Through the optics every dot is seen a little aside of the straight line to it, by an amount that varies smoothly over a
photograph. A dot that does not follow its photograph's smooth field is a stray; so is one that is stated to be far less
sure than the others, since a dot that is cut looks so.
"""

import numpy as np
from numpy.typing import NDArray

from wlr_render.captures.correspondences import SeeThroughCaptures
from wlr_render.geometry.directions import ARCMIN, normalised, tangents_of_dir
from wlr_render.numerics.arrays import BoolArray, FloatArray
from wlr_render.numerics.polynomial import Box, basis, term_count

_TOP_DEGREE = 4
_DOTS_PER_TERM = 8
_SIGMAS, _LEAST_ARCMIN = 8.0, 0.3  # a stray is off by more than both
_LEAST_SURE = 5.0  # times the median standard deviation of the photograph's dots
_ROUNDS = 10  # strays bend the field that they are judged by: the worst go first
_AT_ONCE = 3.0  # what is this much less off than the worst waits for the next round
_MAD = 1.4826  # median absolute deviation to standard deviation


def follow_their_photograph(captures: SeeThroughCaptures, photograph: NDArray[np.int64]) -> BoolArray:
    """(n,) which dots lie where their photograph's smooth field has them; (n,) `photograph` numbers each row's."""
    straight = normalised(captures.point - captures.viewpoint)
    seen = tangents_of_dir(captures.view_dir)
    aside = (seen - tangents_of_dir(straight)) / ARCMIN
    follows = np.ones(len(captures), dtype=bool)
    for one in np.unique(photograph):
        rows = np.flatnonzero(photograph == one)
        sigma = captures.sigma_arcmin[rows]
        sure = rows[sigma <= _LEAST_SURE * np.median(sigma)]
        follows[rows] = False
        follows[sure] = _smooth(seen[sure], aside[sure])
    return follows


def _smooth(place: FloatArray, aside: FloatArray) -> BoolArray:
    """(n,) which of the values (n, 2) at places (n, 2) follow a polynomial through them."""
    kept = np.ones(len(place), dtype=bool)
    degree = next((n for n in range(_TOP_DEGREE, 0, -1) if term_count(2, n) * _DOTS_PER_TERM <= len(place)), 0)
    if degree == 0:
        return kept
    design = basis(place, degree, Box.around(place))
    for _ in range(_ROUNDS):
        coefficients = np.linalg.lstsq(design[kept], aside[kept], rcond=None)[0]
        off = np.linalg.norm(aside - design @ coefficients, axis=1)
        limit = max(_SIGMAS * _MAD * float(np.median(off[kept])), _LEAST_ARCMIN)
        worst = float(off[kept].max())
        if worst <= limit:
            break
        kept = off <= max(limit, worst / _AT_ONCE)
    return kept
