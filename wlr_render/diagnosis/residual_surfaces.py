"""Smooth surfaces through the residual of each photograph.

The scatter about the surface estimates the noise; readings far from it are outliers.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from wlr_render.diagnosis.observations import Observations
from wlr_render.numerics.arrays import BoolArray, FloatArray, IntArray, rows_by_label
from wlr_render.numerics.polynomial import Box, basis, term_count, total_degree

_DEGREE = 6  # highest degree of a surface
_ROWS_PER_COEFFICIENT = 2.5  # readings that each coefficient of an axis needs
_OUTLIER = 6.0  # residual over the noise of its photograph; neither noise nor a smooth effect is so far off
_OUTLIER_ROUNDS = 6  # most rejections of outliers


@dataclass(frozen=True, eq=False)
class Surface:
    """A smooth surface through the residual of one photograph.

    Attributes:
        rows: (m,) the photograph's readings.
        design: (m, terms) its polynomials of the camera pixel.
        left: (m, 2) residual about the surface.
        leverage: (m,) of each row on the surface.
        good: (m,) the rows that it was fitted to: no outliers.
    """

    rows: IntArray
    design: FloatArray
    left: FloatArray
    leverage: FloatArray
    good: BoolArray

    @property
    def terms(self) -> int:
        """Coefficients per axis."""
        return int(self.design.shape[1])

    @property
    def freedom(self) -> int:
        """Degrees of freedom of `left`, both axes."""
        return 2 * (int(self.good.sum()) - self.terms)

    @property
    def squares(self) -> FloatArray:
        """Estimate of the variance of each good reading, per axis (m_good,)."""
        # Weighted by leverage, as noise may grow towards the edge, where a surface follows it most closely.
        unfollowed = (1.0 - self.leverage[self.good]).clip(1e-6)
        return np.asarray(np.mean(self.left[self.good] ** 2, axis=1) / unfollowed)


def image_basis(observations: Observations, rows: IntArray) -> FloatArray | None:
    """Return polynomials (m, terms) of the camera pixel at a photograph's readings; None where these are too few."""
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
    for rows, design, whole in _designs(observations):
        good = known = np.asarray(np.isfinite(residual[rows]).all(axis=1))
        own = np.nan_to_num(residual[rows])
        if good.sum() <= 2 * design.shape[1]:
            continue
        left, leverage, size = _about_surface(design, own, good, whole)
        for _ in range(_OUTLIER_ROUNDS):
            # 1.18: the median length of a two-vector of unit normal components.
            near = known & (size <= _OUTLIER * max(1.0, float(np.median(size[good])) / 1.18))
            if np.array_equal(near, good):
                break
            # An outlier pulls the surface, and its neighbours seem to be outliers until it is left out.
            good = near
            left, leverage, size = _about_surface(design, own, good, whole)
        if good.sum() > 2 * design.shape[1]:
            yield Surface(rows, design, left, leverage, good)


@lru_cache(maxsize=1)
def _designs(observations: Observations) -> list[tuple[IntArray, FloatArray, FloatArray]]:
    """Return the rows of each photograph, its polynomials and their inverse, as surfaces are asked for in rounds."""
    every = ((rows, image_basis(observations, rows)) for rows in photographs(observations))
    return [(rows, design, np.asarray(np.linalg.pinv(design))) for rows, design in every if design is not None]


def _about_surface(
    design: FloatArray, values: FloatArray, good: BoolArray, whole: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the rest (n, 2) of `values` about a surface through the good ones, leverages and studentised lengths.

    `whole` (terms, n) gives the surface by all values.

    A corner that bends the surface to itself is left with little: hence the leverages (R. D. Cook and S. Weisberg,
    "Residuals and Influence in Regression", 1982, chapter 2).
    """
    solve = whole if good.all() else np.asarray(np.linalg.pinv(design[good]))
    left = values - design @ (solve @ values[good])
    leverage = np.sum((design @ solve) ** 2, axis=1)
    spread = np.sqrt(np.where(good, 1.0 - leverage, 1.0 + leverage).clip(1e-6))
    return left, leverage, np.linalg.norm(left, axis=1) / spread
