"""Smooth surfaces through the residual of each photograph, and the noise that neighbouring readings share.

The scatter about the surface estimates the noise; readings far from it are outliers. Surfaces follow noise that
neighbours share. In photographs of many readings, the residual about very smooth surfaces shows that noise: its share
of the variance, its reach and smoothness.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from wlr_render.diagnosis.observations import Observations
from wlr_render.numerics.arrays import BoolArray, FloatArray, IntArray, rows_by_label
from wlr_render.numerics.polynomial import Box, basis, term_count, total_degree
from wlr_render.numerics.shared_noise import Contrasts, SharedNoise, neighbour_distance

_DEGREE = 6  # highest degree of a surface
_ROWS_PER_COEFFICIENT = 2.5  # fewest readings per coefficient of one axis
_OUTLIER = 6.0  # residual over the noise of its photograph that neither noise nor a smooth effect reaches
_OUTLIER_ROUNDS = 6  # most rejections of outliers
CLEARLY = 4.5  # log likelihood that one more parameter must gain: three standard errors
_SHARES = np.linspace(0.0, 0.95, 39)
_REACHES = (0.7, 1.0, 1.4, 2.0, 2.8, 4.0)  # reaches of shared noise, in distances between neighbouring readings
_USUAL_REACH, _REACH_RANGE = 1.7, 0.4  # prior of the reach in these distances: median, and sigma of its logarithm
_PHOTOGRAPHS = (4, 40)  # fewest and most photographs searched for shared noise
_WORK = 4e7  # largest cost of the search for shared noise: readings per photograph cubed, times photographs
_MOST_READINGS = 250  # most readings of a photograph searched for shared noise
_ENOUGH_IN_COMMON = 5  # fewest photographs from which their common residual is fitted
_ENOUGH_FOR_A_CUBIC = 80  # fewest readings of a photograph for a cubic surface
_COMMON_DEGREE = 6  # degree of the residual common to photographs
_SMOOTHEST = 3  # degree of effects of the bench in a photograph; finer structure may be shared noise
_RANK = 1e-9  # relative singular value that counts as zero
_MOST_TAKEN = 0.9  # largest absorbed share of a photograph's noise variance, along one direction, that is restored
_NEGLIGIBLE = 6.0  # log likelihood below the best one's from which a noise field is ignored
_FEW_PHOTOGRAPHS = 8  # number of photographs from which the variance left by surfaces is computed
_NOT_EXCLUDED = 2.0  # fall of log likelihood at two standard errors

_NOTHING_SHARED = SharedNoise(0.0, float("nan"), is_smooth=True)


@dataclass(frozen=True, eq=False)
class Surface:
    """A smooth surface through the residual of one photograph.

    Attributes:
        rows: (m,) the photograph's readings.
        design: (m, terms) polynomials of the camera pixel at these readings.
        left: (m, 2) residual about the surface.
        leverage: (m,) leverage of each row on the surface.
        good: (m,) mask of the fitted rows, without outliers.
    """

    rows: IntArray
    design: FloatArray
    left: FloatArray
    leverage: FloatArray
    good: BoolArray

    @property
    def terms(self) -> int:
        """Number of coefficients per axis."""
        return int(self.design.shape[1])

    @property
    def freedom(self) -> int:
        """Degrees of freedom of `left`, both axes."""
        return 2 * (int(self.good.sum()) - self.terms)

    @property
    def squares(self) -> FloatArray:
        """Estimate of the variance of each good reading, per axis, (m_good,)."""
        # Correct for leverage: noise may grow towards the edge, where a surface follows it most closely.
        unfollowed = (1.0 - self.leverage[self.good]).clip(1e-6)
        return np.asarray(np.mean(self.left[self.good] ** 2, axis=1) / unfollowed)


def image_basis(observations: Observations, rows: IntArray) -> FloatArray | None:
    """Return polynomials (m, terms) of the camera pixel at a photograph's readings; None if there are too few."""
    count = int(len(rows) / _ROWS_PER_COEFFICIENT)
    degree = max((each for each in range(_DEGREE + 1) if term_count(2, each) <= count), default=-1)
    if degree < 2 or not np.isfinite(observations.image_place[rows[0]]).all():
        return None
    box = Box(np.zeros(2), observations.nominal.camera.size_px)
    return basis(observations.image_place[rows], total_degree(2, degree), box)


def photographs(observations: Observations) -> Iterator[IntArray]:
    """Yield the rows of each photograph."""
    yield from rows_by_label(observations.photograph)[1]


def surfaces(observations: Observations, residual: FloatArray) -> Iterator[Surface]:
    """Yield a smooth surface through the residual (n, 2) of each photograph that has enough points."""
    for rows in photographs(observations):
        design, own = image_basis(observations, rows), np.nan_to_num(residual[rows])
        good = known = np.asarray(np.isfinite(residual[rows]).all(axis=1))
        if design is None or good.sum() <= 2 * design.shape[1]:
            continue
        left, leverage, size = _about_surface(design, own, good)
        for _ in range(_OUTLIER_ROUNDS):
            # 1.18: the median length of a two-vector of unit normal components.
            near = known & (size <= _OUTLIER * max(1.0, float(np.median(size[good])) / 1.18))
            if np.array_equal(near, good):
                break
            # An outlier pulls the surface, so that its neighbours seem to be outliers until it is left out.
            good = near
            left, leverage, size = _about_surface(design, own, good)
        if good.sum() > 2 * design.shape[1]:
            yield Surface(rows, design, left, leverage, good)


def _about_surface(
    design: FloatArray, values: FloatArray, good: BoolArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return residuals (n, 2) of `values` about a surface through the good ones, leverages and studentised lengths.

    A reading in a corner pulls the surface towards itself, so that its residual is small: hence the leverages (R. D.
    Cook and S. Weisberg, "Residuals and Influence in Regression", 1982, chapter 2).
    """
    solve = np.linalg.pinv(design[good])
    left = values - design @ (solve @ values[good])
    leverage = np.sum((design @ solve) ** 2, axis=1)
    spread = np.sqrt(np.where(good, 1.0 - leverage, 1.0 + leverage).clip(1e-6))
    return left, leverage, np.linalg.norm(left, axis=1) / spread


@dataclass(frozen=True)
class NeighbourNoise:
    """Noise that neighbours share.

    Attributes:
        shared: field of the shared noise over the image, in pixels; share 0 and length NaN where it is not clear.
        kept: share of the total variance left per degree of freedom about surfaces, whether or not `shared` is clear.
        kept_error: relative standard error of `kept`.
    """

    shared: SharedNoise = _NOTHING_SHARED
    kept: float = 1.0
    kept_error: float = 0.0


def neighbour_noise(
    observations: Observations, residual: FloatArray, own: list[Surface], shape: FloatArray
) -> NeighbourNoise:
    """Return the noise that neighbours share in the photographs of a part.

    It is estimated by restricted maximum likelihood from residuals about very smooth surfaces in some photographs
    (D. A. Harville, "Maximum likelihood approaches to variance component estimation", J. Am. Stat. Assoc. 72 (1977),
    320).

    Args:
        observations: the readings.
        residual: (n, 2) residual in units of the stated sigma.
        own: surfaces through the part's photographs.
        shape: (n,) relative sigma of all readings.
    """
    if not own:
        return NeighbourNoise()
    readings = float(np.median([min(_MOST_READINGS, len(each.rows)) for each in own]))
    step = int(np.ceil(len(own) / np.clip(_WORK / readings**3, *_PHOTOGRAPHS)))
    chosen = own[step // 2 :: step]
    incoherent = _incoherent(observations, residual, own)
    places = [_nearest(observations, each) for each in chosen]
    blocks = [_contrasts(observations, incoherent, rows, shape) for rows in places]
    spacing = neighbour_distance([observations.image_place[rows] for rows in places])
    white = sum(len(each.square) * np.log(np.trace(each.square).clip(1e-300)) for each in blocks)
    gain, best = CLEARLY, _NOTHING_SHARED
    every = list[tuple[SharedNoise, FloatArray]]()
    for tried, is_smooth in product(_REACHES, (True, False)):
        field, likelihood = SharedNoise(1.0, tried * spacing, is_smooth), np.zeros(len(_SHARES))
        for each in blocks:
            log, square = each.likelihood_terms(field, _SHARES)
            likelihood -= log + len(each.square) * np.log(square.clip(1e-300))
        likelihood -= 0.5 * (np.log(tried / _USUAL_REACH) / _REACH_RANGE) ** 2
        likelihood += 2.0 * np.log1p(-_SHARES)  # prior: a small share is likelier than a large one
        every.append((field, likelihood + white))
        at = int(np.argmax(likelihood))
        if likelihood[at] + white > gain:
            gain, best = float(likelihood[at] + white), replace(field, share=float(_SHARES[at]))
    some = chosen[:: len(chosen) // _FEW_PHOTOGRAPHS + 1]
    return NeighbourNoise(best, *_kept(observations, some, every))


def _incoherent(observations: Observations, residual: FloatArray, own: list[Surface]) -> FloatArray:
    """Return the residual (n, 2) minus the part common to photographs of one colour or target pose, which is not noise.

    The common part is a smooth function of the camera pixel that changes with the stage's position. Its fit absorbs
    more of smooth noise than of fine noise; this loss is restored in each photograph as if all noise were white.
    """
    left, stage = residual.copy(), observations.of_captures("stage", 3)
    kinds: dict[tuple[int, int], list[IntArray]] = {}
    for each in own:
        pose = observations.captures[observations.group[each.rows[0]]].target_pose
        kinds.setdefault((pose, int(observations.photograph[each.rows[0]] % 3)), []).append(each.rows[each.good])
    for photographs in kinds.values():
        rows = np.concatenate(photographs)
        if len(photographs) < _ENOUGH_IN_COMMON:
            continue
        place = Box.around(stage[rows]).scaled(stage[rows])
        pixel, box = observations.image_place[rows], Box(np.zeros(2), observations.nominal.camera.size_px)
        coarse = basis(pixel, total_degree(2, _SMOOTHEST), box)
        swimming = [coarse * place[:, [axis]] for axis in range(3)]
        design = np.concatenate([basis(pixel, total_degree(2, _COMMON_DEGREE), box), *swimming], axis=1)
        span = np.linalg.svd(design, full_matrices=False)
        axes = span[0][:, span[1] > _RANK * span[1][0]]
        rest = residual[rows] - axes @ (axes.T @ residual[rows])
        ends = np.cumsum([len(each) for each in photographs])[:-1]
        for mine, taken, its_rest in zip(photographs, np.split(axes, ends), np.split(rest, ends), strict=True):
            directions, singular, _ = np.linalg.svd(taken, full_matrices=False)
            larger = (1.0 - np.minimum(singular**2, _MOST_TAKEN)) ** -0.5 - 1.0
            left[mine] = its_rest + directions @ (larger[:, None] * (directions.T @ its_rest))
    return left


def _kept(
    observations: Observations, own: Sequence[Surface], tried: Sequence[tuple[SharedNoise, FloatArray]]
) -> tuple[float, float]:
    """Return the share of the variance left per degree of freedom about surfaces, and its relative error.

    Both are averages over all possible shared noise, weighted by likelihood: photographs of few readings do not show
    how much noise neighbours share.

    Args:
        observations: the readings.
        own: surfaces of some photographs.
        tried: fields of shared noise, each with the log likelihoods of all `_SHARES`.
    """
    best = max(float(likelihood.max()) for _, likelihood in tried)
    weights, kept, possible = list[FloatArray](), list[FloatArray](), list[FloatArray]()
    for field, likelihood in tried:
        if likelihood.max() < best - _NEGLIGIBLE:
            continue
        left = np.mean([_left_of_shared(observations, each, field) for each in own])
        kept.append(1.0 - _SHARES * (1.0 - left))
        weights.append(np.exp(likelihood - best))
        possible.append(kept[-1][likelihood > best - _NOT_EXCLUDED])
    weight, shares = np.concatenate(weights), np.concatenate(kept)
    # Prior: white and shared noise are equally likely.
    weight[shares == 1.0] *= np.sum(shares < 1.0) / np.sum(shares == 1.0)
    whole = float(np.average(1.0 / shares, weights=weight))
    spread = float(np.sqrt(np.average((1.0 / shares - whole) ** 2, weights=weight)))
    most = 1.0 / float(np.min(np.concatenate(possible)))
    return 1.0 / whole, max(spread, 0.5 * (most - whole)) / whole


def _left_of_shared(observations: Observations, surface: Surface, field: SharedNoise) -> float:
    """Return the mean square, per degree of freedom, of shared noise of unit variance about a surface."""
    place = observations.image_place[surface.rows[surface.good]]
    axes = np.linalg.qr(surface.design[surface.good])[0]
    taken = float(np.sum(axes * (field.correlation(place) @ axes)))
    return (len(place) - taken) / (len(place) - surface.terms)


def _nearest(observations: Observations, surface: Surface) -> IntArray:
    """Return the good readings (m,) of a photograph that are nearest to the middle of all."""
    rows = surface.rows[surface.good]
    if len(rows) <= _MOST_READINGS:
        return rows
    place = observations.image_place[rows]
    return rows[np.argsort(np.sum((place - np.median(place, axis=0)) ** 2, axis=1))[:_MOST_READINGS]]


def _contrasts(observations: Observations, residual: FloatArray, rows: IntArray, shape: FloatArray) -> Contrasts:
    """Return contrasts of some readings of a photograph that very smooth surfaces do not change."""
    place = observations.image_place[rows]
    degree = _SMOOTHEST if len(rows) >= _ENOUGH_FOR_A_CUBIC else _SMOOTHEST - 1
    design = basis(place, total_degree(2, degree), Box.around(place)) / shape[rows][:, None]
    return Contrasts.of(place, design, residual[rows] / shape[rows][:, None])
