"""Captures held out of a fit: how well the others predict them, and how the values change (B. Efron, C. Stein 1981).

The fit without a capture is one Newton step from the fit to all captures, which is exact if the readings are linear in
the values.
"""

from dataclasses import dataclass

import numpy as np

from wlr_render.diagnosis.fit import Fit
from wlr_render.diagnosis.observations import Observations
from wlr_render.numerics.arrays import FloatArray, IntArray, rows_by_label

_FOLDS = 8


@dataclass(frozen=True)
class HeldOutImprovement:
    """Improvement of the prediction of held-out captures.

    Attributes:
        percent: reduction of their rms residual.
        sigma: standard error of the reduction, from leaving out one capture at a time.
        significance: mean difference of the captures' squared residuals over its standard error.
    """

    percent: float
    sigma: float
    significance: float


def left_out_changes(found: Fit, observations: Observations) -> FloatArray:
    """Return the changes (captures, p) of the free parameters, in prior sigmas, when each capture is left out.

    They are NaN for captures without readings.

    Args:
        found: the fit.
        observations: the readings of the fit.
    """
    changes = np.full((len(observations.captures), found.at.free.size), np.nan)
    for number in np.unique(observations.group):
        mine = observations.group == number
        flat = found.jacobian[mine].reshape(-1, found.at.free.size)
        gradient = flat.T @ found.residual[mine].ravel()
        changes[number] = -np.linalg.lstsq(found.information - flat.T @ flat, gradient, rcond=None)[0]
    return changes


def held_out_residual(found: Fit, observations: Observations) -> FloatArray:
    """Return the residual (n, 2), in units of sigma, of each capture when it is held out of the fit."""
    if found.at.free.size == 0:
        return found.at.residual
    changes = left_out_changes(found, observations)
    return np.asarray(found.at.residual - np.einsum("nkp,np->nk", found.at.jacobian, changes[observations.group]))


def held_out_improvement(before: FloatArray, after: FloatArray, group: IntArray) -> HeldOutImprovement:
    """Compare residuals (n,) or (n, 2) before and after by their sums of squares over each held-out capture."""
    rows = rows_by_label(group)[1]
    old, new = (np.array([np.sum(each[mine] ** 2) for mine in rows]) for each in (before, after))
    difference = old - new
    error = float(np.std(difference, ddof=1) * np.sqrt(len(old))) if len(old) > 1 else 0.0
    ratio = float(np.sqrt(new.sum() / old.sum()))
    # Jackknife: the ratios without each capture in turn give the standard error.
    ratios = np.sqrt((new.sum() - new) / (old.sum() - old).clip(1e-300))
    spread = float(np.sqrt((len(old) - 1) / len(old) * np.sum((ratios - ratios.mean()) ** 2)))
    return HeldOutImprovement(100 * (1 - ratio), 100 * spread, float(difference.sum()) / error if error > 0 else 0.0)


def jackknife(found: Fit, observations: Observations) -> FloatArray:
    """Return the jackknife standard errors (p,) of the free parameters over captures, in the parameters' units.

    They include everything that differs between captures, e.g. the stage's repeatability or an effect that the model
    lacks. With m captures, their relative error is about 1 / sqrt(2 (m - 1)). A parameter that only one capture
    determines gets no useful error. NaN for fewer than two captures.

    Args:
        found: the fit.
        observations: the readings of the fit.
    """
    changes = left_out_changes(found, observations) * found.explanation.prior_sigma[found.at.free]
    changes = changes[np.isfinite(changes).all(axis=1)]
    count = len(changes)
    if count < 2:
        return np.full(found.at.free.size, np.nan)
    return np.asarray(np.sqrt((count - 1) * np.mean((changes - changes.mean(axis=0)) ** 2, axis=0)))


def left_out_residual(columns: FloatArray, left: FloatArray, group: IntArray, size: float) -> FloatArray:
    """Return the white residual (n, 2) after a field that is fitted, for each capture, to the other folds' captures.

    Args:
        columns: (n, 2, c) white columns of the field.
        left: (n, 2) white residual.
        group: (n,) capture of each reading.
        size: standard deviation of the coefficients' normal priors.
    """
    after, (_, captures) = left.copy(), rows_by_label(group)
    # Captures are ordered in space and time; taking every `_FOLDS`-th one spreads each fold over both.
    folds = [np.concatenate(captures[number::_FOLDS]) for number in range(min(_FOLDS, len(captures)))]
    every = columns.reshape(2 * len(columns), -1)
    normal, pull = every.T @ every + np.eye(columns.shape[2]) / size**2, every.T @ left.ravel()
    for rows in folds:
        mine = columns[rows].reshape(2 * len(rows), -1)
        values = np.linalg.solve(normal - mine.T @ mine, pull - mine.T @ left[rows].ravel())
        after[rows] -= columns[rows] @ values
    return after
