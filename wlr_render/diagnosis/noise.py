"""Noise of a session: from repeated photographs, from the scatter within each photograph, and as stated.

Within one photograph every physical effect is smooth over the image; what a smooth surface leaves is noise. One test,
`is_significant`, says whether two variances differ: the stated from the measured noise, and a residual from the noise.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wlr_render.diagnosis.observations import DISPLAY, PART_NAMES, SEE_THROUGH, Observations
from wlr_render.diagnosis.settings import DEFAULT, Settings
from wlr_render.numerics.arrays import BoolArray, FloatArray, IntArray
from wlr_render.numerics.polynomial import Box, basis, term_count, total_degree

_DEGREE = 6
_ROWS_PER_COEFFICIENT = 2.5
_OUTLIER_ROUNDS = 6
_ENOUGH_FOR_A_SPREAD = 8  # photographs


@dataclass(frozen=True)
class Variance:
    """A variance per axis in units of sigma squared, and its relative standard error; NaN where it is not known."""

    value: float
    error: float

    @property
    def is_known(self) -> bool:
        """Whether there is one."""
        return bool(np.isfinite(self.value))


def is_significant(difference: float, error: float, reference: float = 1.0, settings: Settings = DEFAULT) -> bool:
    """Whether a difference of two variances is more than chance and large enough to matter.

    Args:
        difference: of the variances, of either sign.
        error: its standard error.
        reference: the variance that it is compared with.
        settings: thresholds.
    """
    return abs(difference) > max(settings.significant_se * error, settings.material_variance * reference)


@dataclass(frozen=True)
class NoiseFloor:
    """The noise of one part of a session, camera pixels per axis.

    Attributes:
        part: its name.
        stated_px: what the bench says.
        within_px: from within the photographs; NaN where they have too few points.
        repeats_px: from photographs taken twice from one place; NaN without such.
        measured_px: the best estimate from both; NaN without either.
        error_px: standard error of `measured_px`.
        used_px: what the diagnosis uses: the stated noise where it is believable, else the measured one.
        is_believable: whether the stated noise does not differ significantly from the measured one.
    """

    part: str
    stated_px: float
    within_px: float
    repeats_px: float
    measured_px: float
    error_px: float
    used_px: float
    is_believable: bool


def noise_floors(
    observations: Observations, residual: FloatArray, settings: Settings = DEFAULT
) -> tuple[NoiseFloor, ...]:
    """Noise of each part that the session has, from the nominal bench's residual (n, 2) in units of sigma."""
    floors = []
    for part in np.unique(observations.part):
        stated = float(observations.sigma_px[part])
        within = _within(observations, residual, part, settings)
        repeats = _repeats(observations, residual, settings) if part == DISPLAY else Variance(np.nan, np.nan)
        measured = _combined(within, repeats, settings)
        within_px, repeats_px, measured_px = (stated * float(np.sqrt(e.value)) for e in (within, repeats, measured))
        error_px, is_believable = np.nan, True
        if measured.value > 0.0:
            error_px = 0.5 * measured_px * measured.error
            # Of logarithms the relative error is the error, whichever of the two is true.
            is_believable = not is_significant(float(np.log(measured.value)), measured.error, 1.0, settings)
        used_px = stated if is_believable else measured_px
        pixels = (stated, within_px, repeats_px, measured_px, error_px, used_px)
        floors.append(NoiseFloor(PART_NAMES[part], *pixels, is_believable))
    return tuple(floors)


def _combined(within: Variance, repeats: Variance, settings: Settings) -> Variance:
    """The mean weighted by inverse variance; repeats alone where the two contradict each other.

    Repeats do not take a fixed pattern that is finer than a photograph's points for noise.
    """
    if not (within.is_known and repeats.is_known):
        return within if within.is_known else repeats
    if within.value == 0.0 or repeats.value == 0.0:
        return within
    error = float(np.hypot(within.error, repeats.error))
    if is_significant(float(np.log(within.value / repeats.value)), error, 1.0, settings):
        return repeats
    weights = np.array([repeats.error, within.error]) ** 2 / error**2
    logarithm = float(weights @ np.log([within.value, repeats.value]))
    return Variance(float(np.exp(logarithm)), within.error * repeats.error / error)


@dataclass(frozen=True)
class ExcessOverNoise:
    """Mean square of a part's residual beside the noise within the same photographs, in units of sigma squared.

    Attributes:
        mean_square: of the residual, per axis.
        noise: of the same readings.
        error: standard error of the difference by noise alone.
        is_significant: whether the residual is more than noise.
    """

    mean_square: float
    noise: float
    error: float
    is_significant: bool


def excess_over_noise(
    observations: Observations, residual: FloatArray, used: BoolArray, settings: Settings = DEFAULT
) -> dict[int, ExcessOverNoise]:
    """For each part: whether a residual (n, 2) in units of sigma is more than the noise of the readings `used` (n,).

    Every photograph is compared with its own noise, so that noise which differs between photographs, over the field,
    or from the stated one is no excess. Where a photograph has too few points, sigma counts as its noise.
    """
    used = used & np.isfinite(residual).all(axis=1)
    observations, residual = observations.of_rows(used), residual[used]
    return {int(part): _excess(observations, residual, int(part), settings) for part in np.unique(observations.part)}


def _excess(observations: Observations, residual: FloatArray, part: int, settings: Settings) -> ExcessOverNoise:
    own = residual[observations.part == part]
    squares, noise, error_squared, count = 0.0, 0.0, 0.0, 0
    rest = np.ones(len(own), dtype=bool)
    for surface in _smoothed(observations, residual, part, settings):
        good, terms = surface.good, surface.terms
        rows, values = surface.rows[good], int(good.sum())
        rest[surface.rows] = False
        # Weighted by leverage, as noise may grow towards the edge, where a surface follows it most closely.
        variance = float(np.mean(surface.left[good] ** 2 / (1.0 - surface.leverage[good]).clip(1e-6)[:, None]))
        squares += float(np.sum(own[rows] ** 2))
        noise += 2 * values * variance
        # For both axes: the difference is what the surface takes, 2 terms of n, less its share of what it leaves.
        error_squared += variance**2 * 4.0 * terms * (1.0 + terms / (values - terms))
        count += 2 * values
    left = 2 * int(rest.sum())
    total = count + left
    error = float(np.sqrt(error_squared + 2.0 * left)) / total
    mean_square, expected = (squares + float(np.sum(own[rest] ** 2))) / total, (noise + left) / total
    excess = mean_square - expected
    return ExcessOverNoise(
        mean_square, expected, error, excess > 0 and is_significant(excess, error, expected, settings)
    )


def sigma_of(floors: tuple[NoiseFloor, ...], stated: FloatArray) -> FloatArray:
    """Per part (3,), the noise to go by."""
    sigma = stated.copy()
    for floor in floors:
        sigma[PART_NAMES.index(floor.part)] = floor.used_px
    return sigma


def _image_places(observations: Observations, part: int) -> tuple[FloatArray, NDArray[np.int64]] | None:
    """Camera pixel (m, 2) of each reading of a part, and which of them belong to one photograph in one colour."""
    group = observations.group[observations.part == part]
    plan, readings = observations.session.plan, observations.session.readings
    if part == DISPLAY and plan.display is not None:
        return plan.display.camera_pixel, 3 * group + plan.display.channel
    if part == SEE_THROUGH and readings.dot_pixel is not None:
        return readings.dot_pixel, group
    return None


def _within(observations: Observations, residual: FloatArray, part: int, settings: Settings) -> Variance:
    """What smooth surfaces over each photograph leave: the median over the photographs, so that one may be bad."""
    found = [
        (np.sum(surface.left[surface.good] ** 2) / degrees, degrees)
        for surface in _smoothed(observations, residual, part, settings)
        for degrees in [2 * (int(surface.good.sum()) - surface.terms)]
    ]
    if not found:
        return Variance(np.nan, np.nan)
    variances, degrees = np.array(found).T
    # The median of chi-squared is smaller than its mean (E. B. Wilson and M. M. Hilferty, PNAS 17 (1931) 684).
    variances = variances / (1.0 - 2.0 / (9.0 * degrees)) ** 3
    median = float(np.median(variances))
    error = float(np.sqrt(2.0 / np.mean(degrees)))
    if median > 0.0 and len(variances) >= _ENOUGH_FOR_A_SPREAD:
        # 1.48: a standard deviation by the median absolute deviation; Gaussian noise scatters least.
        error = max(error, 1.48 * float(np.median(np.abs(variances - median))) / median)
    # 1.25: the standard error of a median over that of a mean.
    few = 1.25 if len(variances) > 2 else 1.0
    return Variance(median, few * error / float(np.sqrt(len(variances))))


def outlier_readings(observations: Observations, residual: FloatArray, settings: Settings = DEFAULT) -> BoolArray:
    """Single readings (n,) far from a smooth surface through the rest of their photograph: wrong bits, wrong dots."""
    outlier = np.zeros(len(observations), dtype=bool)
    for part in np.unique(observations.part):
        own = np.flatnonzero(observations.part == part)
        for surface in _smoothed(observations, residual, part, settings):
            outlier[own[surface.rows[~surface.good]]] = True
    return outlier


@dataclass(frozen=True, eq=False)
class _Surface:
    """A smooth surface through the residual of one photograph.

    Attributes:
        rows: (m,) of the photograph, within the part.
        left: (m, 2) what the surface leaves.
        leverage: (m,) of each row on the surface.
        good: (m,) the rows that it was fitted to: no outliers.
        terms: its coefficients per axis.
    """

    rows: IntArray
    left: FloatArray
    leverage: FloatArray
    good: BoolArray
    terms: int


def _smoothed(observations: Observations, residual: FloatArray, part: int, settings: Settings) -> Iterator[_Surface]:
    """A smooth surface for each photograph that has points enough."""
    found = _image_places(observations, part)
    if found is None:
        return
    place, photograph = found
    own = residual[observations.part == part]
    box = Box(np.zeros(2), observations.nominal.camera.size_px)
    for number in np.unique(photograph):
        rows = np.flatnonzero(photograph == number)
        count = int(len(rows) / _ROWS_PER_COEFFICIENT)
        degree = max((d for d in range(_DEGREE + 1) if term_count(2, d) <= count), default=-1)
        if degree < 2:
            continue
        design, good = basis(place[rows], total_degree(2, degree), box), np.ones(len(rows), dtype=bool)
        for _ in range(_OUTLIER_ROUNDS):
            left, leverage, size = _studentised(design, own[rows], good)
            # 1.18: the median length of a two-vector of unit normal components.
            near = size <= settings.outlier_reading * max(1.0, float(np.median(size[good])) / 1.18)
            if np.array_equal(near, good):
                break
            # An outlier pulls the surface, and its neighbours seem to be outliers until it is left out.
            good = near
        if good.sum() > 2 * design.shape[1]:
            yield _Surface(rows, left, leverage, good, design.shape[1])


def _studentised(design: FloatArray, values: FloatArray, good: BoolArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """What a surface through the good ones of `values` (n, 2) leaves, all leverages, and lengths over spread (n,).

    A corner that bends the surface to itself is left with little: hence the leverages (R. D. Cook and S. Weisberg,
    "Residuals and Influence in Regression", 1982, chapter 2).
    """
    solve = np.linalg.pinv(design[good])
    left = values - design @ (solve @ values[good])
    leverage = np.sum((design @ solve) ** 2, axis=1)
    spread = np.sqrt(np.where(good, 1.0 - leverage, 1.0 + leverage).clip(1e-6))
    return left, leverage, np.linalg.norm(left, axis=1) / spread


def _repeats(observations: Observations, residual: FloatArray, settings: Settings) -> Variance:
    """From display points seen at the same camera pixel from the same place more than once, over sigma.

    What differs smoothly over a photograph is taken off: the bench has moved between the two, and that is no noise.
    """
    plan = observations.session.plan.display
    if plan is None:
        return Variance(np.nan, np.nan)
    place = np.round(np.column_stack([1e9 * plan.stage, 1e3 * plan.camera_pixel, plan.travel, plan.channel]))
    _, point, counts = np.unique(place, axis=0, return_inverse=True, return_counts=True)
    own, times = residual[observations.part == DISPLAY], counts[point]
    sums = np.stack([np.bincount(point, own[:, axis]) for axis in (0, 1)], axis=-1)
    # A deviation from the mean of k readings is smaller than noise by the root of 1 - 1/k.
    deviation = (own - sums[point] / times[:, None]) / np.sqrt(1.0 - 1.0 / times.clip(2))[:, None]
    repeated = np.zeros(len(observations), dtype=bool)
    repeated[np.flatnonzero(observations.part == DISPLAY)[times > 1]] = True
    found = _within(observations.of_rows(repeated), deviation[times > 1], DISPLAY, settings)
    # Of k photographs from one place, the deviations from their mean hold k - 1 independent ones.
    again = float(np.mean(times[times > 1])) if repeated.any() else 2.0
    return Variance(found.value, found.error / float(np.sqrt(1.0 - 1.0 / again)))
