"""How much of a session is noise: from repeated photographs, from within each photograph, and as stated.

Within one photograph every physical effect is smooth over the image; what a smooth surface leaves is noise.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wlr_render.diagnosis.observations import DISPLAY, PART_NAMES, SEE_THROUGH, Observations
from wlr_render.numerics.arrays import BoolArray, FloatArray
from wlr_render.numerics.polynomial import Box, basis, term_count

_DEGREE = 6
_ROWS_PER_COEFFICIENT = 2.5
_STRAY = 6.0  # times the noise: nothing smooth and no noise is so far off
_STRAY_ROUNDS = 6
_BELIEVABLE = 1.1  # a stated sigma that is wrong by less is kept


@dataclass(frozen=True)
class NoiseFloor:
    """The noise of one part of a session, camera pixels per axis.

    Attributes:
        part: its name.
        stated_px: what the bench says.
        within_px: from within the photographs; NaN where they have too few points.
        repeats_px: from photographs taken twice from one place; NaN without such.
        used_px: what the diagnosis goes by.
    """

    part: str
    stated_px: float
    within_px: float
    repeats_px: float
    used_px: float

    @property
    def measured_px(self) -> float:
        """The best measured value: repeats before smoothness; NaN without either."""
        return self.repeats_px if np.isfinite(self.repeats_px) else self.within_px

    @property
    def believable(self) -> bool:
        """Whether the stated value agrees with the measured one to a tenth."""
        return not np.isfinite(self.measured_px) or 1 / _BELIEVABLE < self.measured_px / self.stated_px < _BELIEVABLE


def noise_floors(observations: Observations, residual: FloatArray) -> tuple[NoiseFloor, ...]:
    """Noise of each part that the session has, from the nominal bench's residual (n, 2) in units of sigma."""
    floors = []
    for part in np.unique(observations.part):
        stated = float(observations.sigma_px[part])
        within = stated * _within(observations, residual, part)
        repeats = stated * _repeats(observations, residual) if part == DISPLAY else np.nan
        floor = NoiseFloor(PART_NAMES[part], stated, within, repeats, stated)
        floors.append(floor if floor.believable else NoiseFloor(floor.part, stated, within, repeats, floor.measured_px))
    return tuple(floors)


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


def _within(observations: Observations, residual: FloatArray, part: int) -> float:
    """What smooth surfaces over each photograph leave, over sigma."""
    variances = [
        np.sum(left[good] ** 2) / (2 * (good.sum() - terms))
        for _, left, good, terms in _smoothed(observations, residual, part)
    ]
    # The median over photographs: one that is bad throughout is not noise.
    return float(np.sqrt(np.median(variances))) if variances else np.nan


def stray_readings(observations: Observations, residual: FloatArray) -> BoolArray:
    """Single readings (n,) far from a smooth surface through the rest of their photograph: wrong bits, wrong dots."""
    stray = np.zeros(len(observations), dtype=bool)
    for part in np.unique(observations.part):
        own = np.flatnonzero(observations.part == part)
        for rows, _, good, _ in _smoothed(observations, residual, part):
            stray[own[rows[~good]]] = True
    return stray


def _smoothed(
    observations: Observations, residual: FloatArray, part: int
) -> Iterator[tuple[NDArray[np.int64], FloatArray, BoolArray, int]]:
    """For each photograph: its rows within the part, what a surface leaves, which are no strays, its terms."""
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
        design, good = basis(place[rows], degree, box), np.ones(len(rows), dtype=bool)
        for _ in range(_STRAY_ROUNDS):
            left, size = _studentised(design, own[rows], good)
            # 1.18: the median length of a two-vector of unit normal components.
            near = size <= _STRAY * max(1.0, float(np.median(size[good])) / 1.18)
            if np.array_equal(near, good):
                break
            # A stray pulls the surface, and its neighbours seem astray until it is gone.
            good = near
        if good.sum() > 2 * design.shape[1]:
            yield rows, left, good, design.shape[1]


def _studentised(design: FloatArray, values: FloatArray, good: BoolArray) -> tuple[FloatArray, FloatArray]:
    """What a surface through the good ones of `values` (n, 2) leaves of all, and its length over its spread (n,).

    A corner that bends the surface to itself is left with little: hence the leverages (R. D. Cook and S. Weisberg,
    "Residuals and Influence in Regression", 1982, chapter 2).
    """
    solve = np.linalg.pinv(design[good])
    left = values - design @ (solve @ values[good])
    leverage = np.sum((design @ solve) ** 2, axis=1)
    spread = np.sqrt(np.where(good, 1.0 - leverage, 1.0 + leverage).clip(1e-6))
    return left, np.linalg.norm(left, axis=1) / spread


def _repeats(observations: Observations, residual: FloatArray) -> float:
    """From display points seen at the same camera pixel from the same place more than once, over sigma.

    What differs smoothly over a photograph is taken off: the bench has moved between the two, and that is no noise.
    """
    plan = observations.session.plan.display
    if plan is None:
        return np.nan
    place = np.round(np.column_stack([1e9 * plan.stage, 1e3 * plan.camera_pixel, plan.travel, plan.channel]))
    _, point, counts = np.unique(place, axis=0, return_inverse=True, return_counts=True)
    own, times = residual[observations.part == DISPLAY], counts[point]
    sums = np.stack([np.bincount(point, own[:, axis]) for axis in (0, 1)], axis=-1)
    # A deviation from the mean of k readings is smaller than noise by the root of 1 - 1/k.
    deviation = (own - sums[point] / times[:, None]) / np.sqrt(1.0 - 1.0 / times.clip(2))[:, None]
    repeated = np.zeros(len(observations), dtype=bool)
    repeated[np.flatnonzero(observations.part == DISPLAY)[times > 1]] = True
    return _within(observations.of_rows(repeated), deviation[times > 1], DISPLAY)
