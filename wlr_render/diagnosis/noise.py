"""How much of a session is noise: from repeated photographs, from within each photograph, and as stated.

Within one photograph every physical effect is smooth over the image; what a smooth surface leaves is noise.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wlr_render.diagnosis.observations import DISPLAY, PART_NAMES, SEE_THROUGH, Observations
from wlr_render.numerics.polynomial import Box, basis

FloatArray = NDArray[np.float64]

_DEGREE = 6
_ROWS_PER_COEFFICIENT = 2.5
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
    found = _image_places(observations, part)
    if found is None:
        return np.nan
    place, photograph = found
    own = residual[observations.part == part]
    half = 0.5 * observations.nominal.camera.size_px
    box = Box(np.zeros(2), 2 * half)
    variances = []
    for number in np.unique(photograph):
        rows = photograph == number
        terms = int(np.sum(rows) / _ROWS_PER_COEFFICIENT)
        degree = max((d for d in range(_DEGREE + 1) if (d + 1) * (d + 2) // 2 <= terms), default=-1)
        if degree < 2:
            continue
        design = basis(place[rows], degree, box)
        q, _ = np.linalg.qr(design)
        left = own[rows] - q @ (q.T @ own[rows])
        variances.append(np.sum(left**2) / (2 * (len(left) - design.shape[1])))
    # The median over photographs: a few bad points in one of them are not noise.
    return float(np.sqrt(np.median(variances))) if variances else np.nan


def _repeats(observations: Observations, residual: FloatArray) -> float:
    """From display points seen at the same camera pixel from the same place more than once, over sigma."""
    plan = observations.session.plan.display
    if plan is None:
        return np.nan
    place = np.round(np.column_stack([1e9 * plan.stage, 1e3 * plan.camera_pixel, plan.travel, plan.channel]))
    _, point, counts = np.unique(place, axis=0, return_inverse=True, return_counts=True)
    repeated = counts[point] > 1
    if repeated.sum() < 50:
        return np.nan
    point = point[repeated]
    own = residual[observations.part == DISPLAY][repeated]
    mean = (
        np.stack([np.bincount(point, own[:, axis]) for axis in (0, 1)], axis=-1) / np.bincount(point).clip(1)[:, None]
    )
    degrees = len(own) - len(np.unique(point))
    return float(np.sqrt(np.sum((own - mean[point]) ** 2) / (2 * degrees)))
