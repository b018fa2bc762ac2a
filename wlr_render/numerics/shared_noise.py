"""Noise that neighbouring readings of a photograph share: a stationary random field of short length, plus white noise.

    cov(e_i, e_j) = sigma_i sigma_j ((1 - share) [i = j] + share (1 + d) exp(-d)),    d = sqrt(3) |x_i - x_j| / length

Interpolation of the picture, its compression and moving air cause such noise. Left out of the likelihood, it looks like
motions of the camera and like optics, because the mean of readings that share noise is less accurate than their number
suggests.

The field is of the Matern class of order 3/2, or Gaussian where it is smooth (Rasmussen and Williams, "Gaussian
Processes for Machine Learning", 2006, chapter 4). The class decides how far the tail of the correlation reaches, and
thereby how accurate a mean is. Class, share and length maximise the restricted likelihood (Patterson and Thompson,
Biometrika 58, 1971, 545-554) of the residuals about a polynomial in each photograph.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
import scipy

from wlr_render.numerics.arrays import FloatArray, IntArray
from wlr_render.numerics.polynomial import Box, basis, term_count, total_degree

_LENGTHS = (0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0, 5.6)  # lengths of the field, in distances between neighbours
_USUAL_LENGTH = 3  # index of the length at which the search starts
_SHARES = np.linspace(0.0, 0.96, 49)
_READINGS, _GROUPS = 120, 16  # most readings per group and most groups used; the share's error is then 0.03
_MOST_BYTES = 2e8  # most memory of the cached roots, estimated from the size of the last one
_TOP_ORDER, _PER_TERM = 2, 5  # highest order of the polynomial for motions of the camera, and fewest readings per term
_ODDS = 100.0  # least odds against white noise at which noise counts as shared


@dataclass(frozen=True)
class SharedNoise:
    """Noise that neighbouring readings of a photograph share.

    Attributes:
        share: share of the variance in the field; the rest is white.
        length: correlation length of the field, in the unit of the places.
        is_smooth: whether the field varies smoothly.
    """

    share: float
    length: float
    is_smooth: bool = False

    def correlation(self, place: FloatArray) -> FloatArray:
        """Return the correlation (n, n) of the field between places (n, 2)."""
        return self.correlation_at(scipy.spatial.distance.cdist(place, place))

    def correlation_at(self, distance: FloatArray) -> FloatArray:
        """Return the correlation of the field between places at given distances."""
        if self.is_smooth:
            return np.asarray(np.exp(-0.5 * (distance / self.length) ** 2))
        apart = distance * (np.sqrt(3.0) / self.length)
        return np.asarray((1.0 + apart) * np.exp(-apart))

    def root(self, place: FloatArray, kept: FloatArray) -> FloatArray:
        """Return a lower triangular matrix (n, n) that makes the noise of readings of unit sigma white.

        Args:
            place: (n, 2) places of the readings of one photograph.
            kept: (n,) weights of the readings, from 1 down to 0 for outliers, which scale the white noise.
        """
        key = self, place.tobytes(), kept.tobytes()
        root = _roots.pop(key, None)
        if root is None:
            root = self._new_root(place, kept)
        _roots[key] = root
        while len(_roots) * root.nbytes > _MOST_BYTES:
            _roots.pop(next(iter(_roots)))
        return root

    def _new_root(self, place: FloatArray, kept: FloatArray) -> FloatArray:
        rows = np.flatnonzero(kept > 0)
        covariance = self.share * self.correlation(place[rows])
        covariance[np.diag_indices(len(rows))] += (1.0 - self.share) / kept[rows] ** 2
        root = np.zeros((len(kept), len(kept)))
        root[np.ix_(rows, rows)] = scipy.linalg.lapack.dtrtri(np.linalg.cholesky(covariance), lower=1)[0]
        root.flags.writeable = False
        return root


_roots: dict[tuple[SharedNoise, bytes, bytes], FloatArray] = {}
"""Roots in the order of their last use: captures often share places, and a fit needs the roots repeatedly."""


@dataclass(frozen=True)
class Contrasts:
    """Contrasts of a photograph's readings, orthogonal to smooth functions of the place.

    Attributes:
        distance: (n, n) distances between the places of the readings.
        across: (n, c) orthonormal contrasts.
        square: (c, c) second moments of their values, summed over both axes.
    """

    distance: FloatArray
    across: FloatArray
    square: FloatArray

    @classmethod
    def of(cls, place: FloatArray, design: FloatArray, values: FloatArray) -> "Contrasts":
        """Return contrasts, orthogonal to the columns of a design (n, p), of values (n, k) at places (n, 2)."""
        axes, sizes, _ = np.linalg.svd(design)
        across = np.asarray(axes[:, int(np.sum(sizes > 1e-9 * sizes[0])) :])
        seen = across.T @ values
        return cls(scipy.spatial.distance.cdist(place, place), across, seen @ seen.T)

    def likelihood_terms(self, field: SharedNoise, shares: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return terms of the restricted likelihood of noise of unit variance with shares (k,) of a field.

        Returns:
            Logarithm (k,) of the determinant of the contrasts' covariance, and their sum of squares (k,) weighted by
            its inverse.
        """
        sizes, axes = np.linalg.eigh(self.across.T @ field.correlation_at(self.distance) @ self.across)
        power = np.sum(axes * (self.square @ axes), axis=0)
        variance = 1.0 + shares * (np.maximum(sizes, 0.0)[:, None] - 1.0)
        return np.log(variance).sum(axis=0), np.sum(power[:, None] / variance, axis=0)


def find_shared_noise(
    places: Sequence[FloatArray],
    residuals: Sequence[FloatArray],
    unsure: Callable[[int, IntArray], FloatArray],
) -> SharedNoise | None:
    """Return the noise that neighbours share, by restricted likelihood; None if white noise is about as probable.

    A fit follows the noise that readings share, so that its residuals have less of it: therefore the likelihood is
    averaged over the posterior of the fit (Dempster, Laird and Rubin, J. Royal Statistical Society B 39, 1977, 1-38).

    Args:
        places: (n, 2) places of the readings of each photograph.
        residuals: (n, 2) residuals of a fit, in units of sigma, without outliers.
        unsure: (number of a photograph, some of its readings (m,)) -> (m, k) factor F of the posterior covariance F F'
            of the fitted values, over their sigma.
    """
    rng = np.random.default_rng(0)
    chosen = [each for each in range(len(places)) if len(places[each]) > 2 * _PER_TERM]
    chosen = sorted(rng.permutation(chosen)[:_GROUPS])
    spacing = neighbour_distance([places[each] for each in chosen])
    if not spacing > 0:
        return None
    patches = []
    for each in chosen:
        rows = _patch(places[each], rng)
        values = np.hstack([residuals[each][rows], np.sqrt(2.0) * unsure(each, rows)])
        patches.append(Contrasts.of(places[each][rows], _polynomials(places[each][rows]), values))

    @cache
    def minus_two(row: int, is_smooth: bool) -> FloatArray:
        """Return -2 log restricted likelihood (shares,) of a field, at the best noise size for each share."""
        field = SharedNoise(1.0, _LENGTHS[row] * spacing, is_smooth)
        logs, squares, count = np.zeros(len(_SHARES)), np.zeros(len(_SHARES)), 0
        for patch in patches:
            log, square = patch.likelihood_terms(field, _SHARES)
            logs += 2.0 * log
            squares += square
            count += 2 * patch.across.shape[1]
        return np.asarray(logs + count * np.log(np.maximum(squares, 1e-300)))

    def best_length(is_smooth: bool) -> int:
        row, last = _USUAL_LENGTH, -1
        while row != last:  # the likelihood has one maximum along the length
            near = range(max(row - 1, 0), min(row + 2, len(_LENGTHS)))
            row, last = min(near, key=lambda each: float(minus_two(each, is_smooth).min())), row
        return row

    fields = [(best_length(is_smooth), is_smooth) for is_smooth in (False, True)]
    row, is_smooth = min(fields, key=lambda each: float(minus_two(*each).min()))
    column = int(np.argmin(minus_two(row, is_smooth)))
    if minus_two(row, is_smooth)[0] - minus_two(row, is_smooth)[column] < 2.0 * np.log(_ODDS):
        return None
    return SharedNoise(float(_SHARES[column]), float(_LENGTHS[row] * spacing), is_smooth)


def neighbour_distance(places: Sequence[FloatArray]) -> float:
    """Return the median distance between neighbours among the places (n, 2) of several photographs; NaN without any."""
    distances = [np.median(scipy.spatial.KDTree(place).query(place, 2)[0][:, 1]) for place in places if len(place) > 1]
    return float(np.median(distances)) if distances else np.nan


def _patch(place: FloatArray, rng: np.random.Generator) -> IntArray:
    """Return readings (m,) around a random one, so that neighbours stay together."""
    if len(place) <= _READINGS:
        return np.arange(len(place))
    middle = place[rng.integers(len(place))]
    return np.argsort(np.sum((place - middle) ** 2, axis=1))[:_READINGS]


def _polynomials(place: FloatArray) -> FloatArray:
    """Return polynomials (n, p) of the places, which a motion of the camera can change."""
    order = next(n for n in range(_TOP_ORDER, -1, -1) if n == 0 or term_count(2, n) * _PER_TERM <= len(place))
    return basis(place, total_degree(2, order), Box.around(place))
