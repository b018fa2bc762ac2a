"""Noise of a session: its size by part, photograph and place in the image, and the share common to neighbours.

Within one photograph every physical effect is smooth over the image; the residual of a smooth surface is noise. The
noise of a reading is the noise of its part, times a factor of its photograph, times a factor that grows from the middle
of the image to its corner. A share of it may be a smooth random field common to neighbouring readings of a photograph
(a breathing autofocus, moving air, an interpolating code).
"""

from dataclasses import dataclass, replace

import numpy as np

from wlr_render.diagnosis.observations import DISPLAY, PART_NAMES, Observations
from wlr_render.diagnosis.residual_surfaces import CLEARLY, NeighbourNoise, Surface, neighbour_noise, surfaces
from wlr_render.numerics.arrays import BoolArray, FloatArray, IntArray
from wlr_render.numerics.shared_noise import SharedNoise

SIGNIFICANT_SE = 3.0
"""Standard errors beyond which two variances differ: chance exceeds 3 in one of 700 comparisons."""
MATERIAL_VARIANCE = 0.1
"""Relative difference of a variance below which neither verdict nor error bars change much."""
_STATED_ERROR = 0.1  # relative error of a sigma that a bench states
_ENOUGH_FOR_A_SPREAD = 8  # fewest photographs whose spread gives an error
_RIM_FACTORS = np.arange(0.3, 5.01, 0.05)
_SPREADS = np.concatenate([[0.0], np.geomspace(0.03, 2.0, 60)])


@dataclass(frozen=True)
class Variance:
    """A variance per axis in units of sigma squared, and its relative standard error; NaN where unknown."""

    value: float
    error: float

    @property
    def is_known(self) -> bool:
        """True if the variance is known."""
        return bool(np.isfinite(self.value))


_UNKNOWN = Variance(np.nan, np.nan)


def is_significant(difference: float, error: float) -> bool:
    """Return whether two variances differ by more than chance, and by enough to matter.

    Args:
        difference: difference of their logarithms, of either sign.
        error: standard error of the difference.
    """
    return abs(difference) > max(SIGNIFICANT_SE * error, MATERIAL_VARIANCE)


@dataclass(frozen=True)
class NoiseFloor:
    """The noise of one part of a session, camera pixels per axis: root mean square over its readings.

    Attributes:
        part: name of the part.
        stated_px: noise as the bench states it.
        within_px: noise within single photographs; NaN where they have too few points.
        repeats_px: noise between photographs repeated from one place; NaN without such repeats.
        measured_px: the best estimate from both; NaN without either.
        error_px: standard error of `measured_px`.
        used_px: noise that the diagnosis uses: stated and measured noise weighted by their errors; the measured one
            where the stated one is not believable.
        is_believable: whether the stated noise does not differ significantly from the measured one.
        rim_factor: ratio of the noise in the corner of the image to the middle; 1 without a clear difference.
        photographs_differ: standard deviation of the logarithm of the photographs' noise; 0 if not clear.
        shared: share of the variance that neighbouring readings have in common; 0 if not clear.
        shared_reach_px: reach of the shared noise in the image; NaN where nothing is shared.
        shared_is_smooth: whether the shared noise varies smoothly over the image.
    """

    part: str
    stated_px: float
    within_px: float
    repeats_px: float
    measured_px: float
    error_px: float
    used_px: float
    is_believable: bool
    rim_factor: float = 1.0
    photographs_differ: float = 0.0
    shared: float = 0.0
    shared_reach_px: float = float("nan")
    shared_is_smooth: bool = True

    def shared_correlation(self, place: FloatArray) -> FloatArray:
        """Return the correlation (m, m) of the shared noise between places (m, 2) in the image."""
        return SharedNoise(self.shared, self.shared_reach_px, self.shared_is_smooth).correlation(place)


@dataclass(frozen=True, eq=False)
class Noise:
    """Noise of all readings.

    Attributes:
        floors: noise of each part that the session has.
        sigma_px: (n,) standard deviation of each reading per axis, camera pixels.
        outlier: (n,) mask of the readings too far from their neighbours to be noise.
    """

    floors: tuple[NoiseFloor, ...]
    sigma_px: FloatArray
    outlier: BoolArray

    def floor(self, part: int) -> NoiseFloor:
        """Return the noise of a part by its number."""
        return next(each for each in self.floors if each.part == PART_NAMES[part])


def noise_of(observations: Observations, residual: FloatArray) -> Noise:
    """Estimate the noise of a session's readings from a residual (n, 2) in units of the stated sigma."""
    found = list(surfaces(observations, residual))
    outlier, shape = np.zeros(len(observations), dtype=bool), np.ones(len(observations))
    for surface in found:
        outlier[surface.rows[~surface.good]] = True
    floors = []
    for part in np.unique(observations.part):
        own = [each for each in found if observations.part[each.rows[0]] == part]
        rows = observations.part == part
        rim = _rim_factor(observations, own)
        shape[rows] *= _over_field(observations, np.flatnonzero(rows), rim)
        factors, differ = _photograph_factors(own, shape)
        for surface, factor in zip(own, factors, strict=True):
            shape[surface.rows] *= factor
        shape[rows] /= np.sqrt(np.mean(shape[rows] ** 2))
        floors.append(_floor(observations, residual, own, shape, int(part), rim, differ))
    sigma = observations.sigma_px * shape
    for floor in floors:
        sigma[observations.part == PART_NAMES.index(floor.part)] *= floor.used_px / floor.stated_px
    return Noise(tuple(floors), sigma, outlier)


def measured_at_run_time(floor: NoiseFloor, factor: float, readings: int) -> NoiseFloor:
    """Return the run-time noise as measured from `readings` residuals: `factor` times the noise used so far."""
    measured = factor * floor.used_px
    variance_error = float(np.sqrt(1.0 / readings))
    is_believable = not is_significant(2.0 * float(np.log(measured / floor.stated_px)), variance_error)
    used = floor.used_px if is_believable else measured
    return replace(
        floor, measured_px=measured, error_px=0.5 * variance_error * measured, used_px=used, is_believable=is_believable
    )


def _floor(
    observations: Observations,
    residual: FloatArray,
    own: list[Surface],
    shape: FloatArray,
    part: int,
    rim: float,
    differ: float,
) -> NoiseFloor:
    stated = float(np.sqrt(np.mean(observations.sigma_px[observations.part == part] ** 2)))
    neighbours = neighbour_noise(observations, residual, own, shape)
    within = _within(own, shape, neighbours)
    repeats = _repeats(observations, residual, shape, neighbours) if part == DISPLAY else _UNKNOWN
    measured = _combined(within, repeats)
    within_px, repeats_px, measured_px = (stated * float(np.sqrt(e.value)) for e in (within, repeats, measured))
    error_px, used_px, is_believable = np.nan, stated, True
    if measured.value > 0.0:
        error_px = 0.5 * measured_px * measured.error
        # The relative error is the error of the logarithm, whichever of the two variances is true.
        logarithm = float(np.log(measured.value))
        is_believable = not is_significant(logarithm, measured.error)
        weight = (2.0 * _STATED_ERROR) ** 2 / ((2.0 * _STATED_ERROR) ** 2 + measured.error**2)
        used_px = stated * float(np.exp(0.5 * weight * logarithm)) if is_believable else measured_px
    pixels, field = (stated, within_px, repeats_px, measured_px, error_px, used_px), neighbours.shared
    return NoiseFloor(PART_NAMES[part], *pixels, is_believable, rim, differ, field.share, field.length, field.is_smooth)


def _over_field(observations: Observations, rows: IntArray, rim: float) -> FloatArray:
    """Return the noise factor at the rows, which grows from 1 in the middle of the image to `rim` in its corner."""
    centre = 0.5 * np.asarray(observations.nominal.camera.size_px, dtype=np.float64)
    place = np.nan_to_num(observations.image_place[rows] - centre)
    return np.asarray(1.0 + (rim - 1.0) * np.sum(place**2, axis=1) / float(centre @ centre))


def _rim_factor(observations: Observations, own: list[Surface]) -> float:
    """Return the ratio of the noise in the corner to the middle, by maximum likelihood; 1 if it is not clear."""
    if not own:
        return 1.0
    squares = np.concatenate([each.squares / np.mean(each.squares).clip(1e-300) for each in own])
    rows = np.concatenate([each.rows[each.good] for each in own])
    photograph = np.repeat(np.arange(len(own)), [int(each.good.sum()) for each in own])
    count = np.bincount(photograph)
    spread = np.stack([_over_field(observations, rows, rim) ** 2 for rim in (*_RIM_FACTORS, 1.0)])
    size = np.stack([np.bincount(photograph, squares / each) / count for each in spread])
    # Two values per reading, one for each axis, cancel the factor 1/2 of the log likelihood.
    likelihood = -np.sum(np.log(spread), axis=1) - np.sum(count * np.log(size.clip(1e-300)), axis=1)
    best = int(np.argmax(likelihood[:-1]))
    return float(_RIM_FACTORS[best]) if likelihood[best] - likelihood[-1] > CLEARLY else 1.0


def _photograph_factors(own: list[Surface], shape: FloatArray) -> tuple[FloatArray, float]:
    """Return the factor of each photograph's noise, and the standard deviation of the factors' logarithms.

    The logarithms are taken as normal about a common mean; their spread is estimated, and each is shrunk towards the
    mean accordingly.
    """
    if len(own) < 3:
        return np.ones(len(own)), 0.0
    variance = np.array([np.mean(each.squares / shape[each.rows[each.good]] ** 2) for each in own])
    if np.min(variance) <= 0.0:
        return np.ones(len(own)), 0.0
    error = 2.0 / np.array([each.freedom for each in own])  # variance of the logarithm
    logarithm = np.log(variance) + 0.5 * error
    total = _SPREADS[:, None] ** 2 + error
    mean = np.sum(logarithm / total, axis=1) / np.sum(1.0 / total, axis=1)
    likelihood = -0.5 * np.sum(np.log(total) + (logarithm - mean[:, None]) ** 2 / total, axis=1)
    best = int(np.argmax(likelihood))
    if likelihood[best] - likelihood[0] < CLEARLY:
        return np.ones(len(own)), 0.0
    spread = float(_SPREADS[best]) ** 2
    shrunk = spread / (spread + error) * (logarithm - mean[best])
    return np.exp(0.5 * shrunk), 0.5 * float(_SPREADS[best])


def _combined(within: Variance, repeats: Variance) -> Variance:
    """Return the mean weighted by inverse variance, or the smaller of the two where they contradict each other.

    If repeats are smaller, the photographs contain a fixed pattern finer than their points. If they are larger, the
    bench has moved between the photographs. Neither is noise.
    """
    if not (within.is_known and repeats.is_known):
        return within if within.is_known else repeats
    if within.value == 0.0 or repeats.value == 0.0:
        return within
    error = float(np.hypot(within.error, repeats.error))
    if is_significant(float(np.log(within.value / repeats.value)), error):
        return repeats if repeats.value < within.value else within
    weights = np.array([repeats.error, within.error]) ** 2 / error**2
    logarithm = float(weights @ np.log([within.value, repeats.value]))
    return Variance(float(np.exp(logarithm)), within.error * repeats.error / error)


def _within(own: list[Surface], shape: FloatArray, shared: NeighbourNoise) -> Variance:
    """Return the variance relative to `shape` squared: the median over the photographs, in case one is bad.

    Args:
        own: surfaces of the part.
        shape: (n,) relative sigma of all readings.
        shared: noise that neighbours share, which surfaces follow.
    """
    if not own:
        return _UNKNOWN
    variances = np.array([np.mean(each.squares / shape[each.rows[each.good]] ** 2) for each in own])
    degrees = np.array([each.freedom for each in own])
    # The median of chi-squared is smaller than its mean (E. B. Wilson and M. M. Hilferty, PNAS 17 (1931) 684).
    variances = variances / (1.0 - 2.0 / (9.0 * degrees)) ** 3
    median = float(np.median(variances))
    error = float(np.sqrt(2.0 / np.mean(degrees)))
    if median > 0.0 and len(variances) >= _ENOUGH_FOR_A_SPREAD:
        # 1.48: ratio of a standard deviation to the median absolute deviation; Gaussian noise scatters least.
        error = max(error, 1.48 * float(np.median(np.abs(variances - median))) / median)
    # 1.25: ratio of the standard errors of a median and a mean.
    few = 1.25 if len(variances) > 2 else 1.0
    error = few * error / float(np.sqrt(len(variances)))
    return Variance(median / shared.kept, float(np.hypot(error, shared.kept_error)))


def _repeats(observations: Observations, residual: FloatArray, shape: FloatArray, shared: NeighbourNoise) -> Variance:
    """Return the variance from display points seen more than once, at one camera pixel from one place.

    Smooth differences between photographs are subtracted: they are motions of the bench, not noise.
    """
    plan = observations.session.plan.display
    if plan is None:
        return _UNKNOWN
    place = np.round(np.column_stack([1e9 * plan.stage, 1e3 * plan.camera_pixel, plan.travel, plan.channel]))
    _, point, counts = np.unique(place, axis=0, return_inverse=True, return_counts=True)
    own, times = residual[observations.part == DISPLAY], counts[point]
    sums = np.stack([np.bincount(point, own[:, axis]) for axis in (0, 1)], axis=-1)
    # A deviation from the mean of k readings is sqrt(1 - 1/k) times the noise.
    deviation = (own - sums[point] / times[:, None]) / np.sqrt(1.0 - 1.0 / times.clip(2))[:, None]
    repeated = np.zeros(len(observations), dtype=bool)
    repeated[np.flatnonzero(observations.part == DISPLAY)[times > 1]] = True
    if not repeated.any():
        return _UNKNOWN
    twice = list(surfaces(observations.of_rows(repeated), deviation[times > 1]))
    found = _within(twice, shape[repeated], shared)
    # Only k - 1 of the k deviations from the mean of k photographs are independent.
    again = float(np.mean(times[times > 1]))
    return Variance(found.value, found.error / float(np.sqrt(1.0 - 1.0 / again)))
