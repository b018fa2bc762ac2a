"""Whole captures that moved: coherent residuals of one photograph that no change of the bench as a whole explains."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wlr_render.diagnosis import evidence
from wlr_render.diagnosis.causes import CAUSES
from wlr_render.diagnosis.extension import Hypothesis, Predictor
from wlr_render.diagnosis.fit import Fit
from wlr_render.diagnosis.observations import SEE_THROUGH, CaptureName, Observations
from wlr_render.numerics.arrays import FloatArray

_POSE = ("camera_pupil_offset", "camera_rotation")
_SIGNIFICANT = 25.0  # chi-squared per degree of freedom, over the fit's, that a pose of its own must gain a capture
_APART = 6.0  # times the spread of all captures' root gains above their median
_MOST = 0.1  # of the captures; more than that, and more than two, are no outliers


@dataclass(frozen=True)
class MovedCapture:
    """A capture set aside.

    Attributes:
        capture: which.
        shift_mm: (3,) by how much its camera seems to stand elsewhere, device frame; None where dots are placed by a
            photograph without the headset, which moves with the camera.
        turn_deg: (3,) by how much it seems to be turned; likewise.
        rms_before, rms_after: its rms residual in units of sigma, without and with that move.
    """

    capture: CaptureName
    shift_mm: tuple[float, ...] | None
    turn_deg: tuple[float, ...] | None
    rms_before: float
    rms_after: float


def moved_captures(predictor: Predictor, fit: Fit, good: NDArray[np.bool_]) -> list[MovedCapture]:
    """Captures that stand out from all others after a fit, by the gain of a camera pose of their own.

    A run-time recording has no camera pose, and is never set aside.

    Args:
        predictor: of all readings.
        fit: to those that counted so far.
        good: (n,) readings that may count: no strays.
    """
    observations = predictor.observations
    state = predictor.state(fit.extension)
    columns = [predictor.added(state, fit.extension.plus(_hypothesis(name))) for name in _POSE]
    poses = np.concatenate([each.jacobian for each in columns], axis=-1)
    if poses.shape[-1] < sum(len(CAUSES[name].parameters) for name in _POSE):
        return []
    residuals = columns[0].residual
    usable = good & np.isfinite(residuals).all(axis=1) & np.isfinite(poses).all(axis=(1, 2))
    gains, moves = np.full(len(observations.captures), np.nan), {}
    for number in np.unique(observations.group[usable]):
        rows = usable & (observations.group == number)
        jacobian, residual = poses[rows].reshape(-1, poses.shape[-1]), residuals[rows].ravel()
        if len(residual) < 4 * poses.shape[-1]:
            continue
        pose = np.linalg.lstsq(jacobian, residual, rcond=None)[0]
        left = residual - jacobian @ pose
        gains[number] = (residual @ residual - left @ left) / poses.shape[-1]
        moves[number] = (pose, float(np.sqrt(np.mean(residual**2))), float(np.sqrt(np.mean(left**2))))
    if not moves:
        return []
    root = np.sqrt(gains)
    middle = np.nanmedian(root)
    # 1.48: a standard deviation by the median absolute deviation.
    usual = middle + _APART * 1.48 * np.nanmedian(np.abs(root - middle))
    apart = np.flatnonzero((gains > _SIGNIFICANT * max(1.0, evidence.misfit(fit))) & (root > usual))
    if len(apart) > max(2, _MOST * len(observations.captures)):
        return []
    return [_moved(observations, int(number), *moves[int(number)]) for number in apart]


def _moved(observations: Observations, number: int, pose: FloatArray, before: float, after: float) -> MovedCapture:
    name, plan = observations.captures[number], observations.session.plan.see_through
    if name.part == SEE_THROUGH and plan is not None and plan.bare_pixel is not None:
        return MovedCapture(name, None, None, before, after)
    values = pose * [parameter.plausible for cause in _POSE for parameter in CAUSES[cause].parameters]
    return MovedCapture(name, tuple(values[:3].tolist()), tuple(values[3:].tolist()), before, after)


def kept(predictor: Predictor, outliers: Sequence[MovedCapture]) -> NDArray[np.bool_]:
    """Mask (n,) of the readings that no outlier has."""
    observations = predictor.observations
    aside = {outlier.capture for outlier in outliers}
    bad = [number for number, name in enumerate(observations.captures) if name in aside]
    return ~np.isin(observations.group, bad)


def _hypothesis(name: str) -> Hypothesis:
    return Hypothesis(CAUSES[name], next(iter(CAUSES[name].variants)))
