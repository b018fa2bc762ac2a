"""Evidence from captures that were not fitted: each capture is predicted by a fit to all the others."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wlr_render.diagnosis.fit import Fit
from wlr_render.numerics.arrays import FloatArray


@dataclass(frozen=True)
class HeldOutGain:
    """How much closer held-out captures are predicted.

    Attributes:
        percent: reduction of their rms residual.
        sigma: one standard error of that, from the spread of the captures' differences.
        significance: mean difference of the captures' squared residuals over its standard error.
    """

    percent: float
    sigma: float
    significance: float


def held_out_squares(fit: Fit, group: NDArray[np.int64], groups: int) -> FloatArray:
    """Sum of squared residuals of each capture (groups,) when it is left out of the fit; NaN for unused captures.

    The fit without a capture is one Newton step from the fit with it, which is exact for what is left to change.
    """
    rows = np.flatnonzero(fit.used)
    jacobian, residual, owner = fit.at.jacobian[rows], fit.residual[rows], group[rows]
    count = jacobian.shape[-1]
    information, gradient = np.zeros((groups, count, count)), np.zeros((groups, count))
    for number in np.unique(owner):
        mine = owner == number
        flat = jacobian[mine].reshape(2 * int(mine.sum()), count)
        information[number] = flat.T @ flat
        gradient[number] = flat.T @ residual[mine].ravel()
    total = np.linalg.inv(fit.covariance)
    squares = np.full(groups, np.nan)
    for number in np.unique(owner):
        mine = owner == number
        left = residual[mine]
        if count:
            change = -np.linalg.lstsq(total - information[number], gradient[number], rcond=None)[0]
            left = left - jacobian[mine] @ change
        squares[number] = np.sum(left**2)
    return squares


def held_out_gain(before: FloatArray, after: FloatArray) -> HeldOutGain:
    """Compare two fits by their held-out squares per capture (groups,); captures that either lacks are left out."""
    both = np.isfinite(before) & np.isfinite(after)
    old, new = before[both], after[both]
    difference = old - new
    error = float(np.std(difference, ddof=1) * np.sqrt(len(old)))
    ratio = float(np.sqrt(new.sum() / old.sum()))
    # Leave-one-capture-out values of the ratio give its standard error.
    ratios = np.sqrt((new.sum() - new) / (old.sum() - old))
    spread = float(np.sqrt((len(old) - 1) / len(old) * np.sum((ratios - ratios.mean()) ** 2)))
    return HeldOutGain(100 * (1 - ratio), 100 * spread, float(difference.sum()) / error if error > 0 else 0.0)
