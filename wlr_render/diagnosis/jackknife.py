"""Standard errors of a fit's values from how they scatter when captures are left out (B. Efron, C. Stein 1981)."""

import numpy as np

from wlr_render.diagnosis.fit import Fit
from wlr_render.numerics.arrays import FloatArray, IntArray


def left_out_changes(found: Fit, group: IntArray, groups: int) -> FloatArray:
    """Changes (groups, p) of the free parameters when a capture is left out; NaN for captures without readings.

    A fit without a capture is one Newton step from the fit with it (as in `fit.held_out_squares`).

    Args:
        found: the fit.
        group: (n,) capture of each reading.
        groups: number of captures.

    Returns:
        The changes in the parameters' units, in the order of `found.at.free`.
    """
    jacobian, residual = found.jacobian, found.residual
    changes = np.full((groups, found.at.free.size), np.nan)
    for number in np.unique(group):
        mine = group == number
        flat = jacobian[mine].reshape(2 * int(mine.sum()), found.at.free.size)
        gradient = flat.T @ residual[mine].ravel()
        changes[number] = -np.linalg.lstsq(found.information - flat.T @ flat, gradient, rcond=None)[0]
    prior_sigma = np.array([parameter.prior_sigma for parameter in found.explanation.parameters()])
    return np.asarray(changes * prior_sigma[found.at.free])


def jackknife(found: Fit, group: IntArray, groups: int) -> FloatArray:
    """Jackknife standard errors (p,) of the free parameters over captures, in the parameters' units.

    They contain whatever differs from capture to capture, e.g. the stage's repeatability or an effect that the model
    lacks. With m captures, their relative error is about 1 / sqrt(2 (m - 1)). A parameter that only one capture
    determines gets no useful error. NaN for fewer than two captures.

    Args:
        found: the fit.
        group: (n,) capture of each reading.
        groups: number of captures.
    """
    changes = left_out_changes(found, group, groups)
    changes = changes[np.isfinite(changes).all(axis=1)]
    count = len(changes)
    if count < 2:
        return np.full(found.at.free.size, np.nan)
    return np.asarray(np.sqrt((count - 1) * np.mean((changes - changes.mean(axis=0)) ** 2, axis=0)))
