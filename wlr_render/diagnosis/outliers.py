"""Whole captures that moved: coherent residuals of one photograph that no change of the bench as a whole explains."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wlr_render.diagnosis.causes import CAUSES
from wlr_render.diagnosis.extension import Hypothesis, Predictor
from wlr_render.diagnosis.fit import Fit
from wlr_render.diagnosis.observations import CaptureName

FloatArray = NDArray[np.float64]

_POSE = ("camera_pupil_offset", "camera_rotation")
_SIGNIFICANT = 25.0  # chi-squared per degree of freedom that a pose of its own must gain a capture
_APART = 10.0  # times the median of all captures
_MOST = 0.1  # of the captures; more than that are no outliers


@dataclass(frozen=True)
class MovedCapture:
    """A capture set aside.

    Attributes:
        capture: which.
        shift_mm: (3,) by how much its camera seems to stand elsewhere, device frame.
        turn_deg: (3,) by how much it seems to be turned.
        rms_before, rms_after: its rms residual in units of sigma, without and with that move.
    """

    capture: CaptureName
    shift_mm: tuple[float, ...]
    turn_deg: tuple[float, ...]
    rms_before: float
    rms_after: float


def moved_captures(predictor: Predictor, fit: Fit) -> list[MovedCapture]:
    """Captures that stand out from all others after a fit, by the gain of a camera pose of their own.

    A run-time recording has no camera pose, and is never set aside.
    """
    observations = predictor.observations
    state = predictor.state(fit.extension)
    columns = [predictor.added(state, fit.extension.plus(_hypothesis(name))) for name in _POSE]
    poses = np.concatenate([each.jacobian for each in columns], axis=-1)
    if poses.shape[-1] < sum(len(CAUSES[name].parameters) for name in _POSE):
        return []
    residuals = columns[0].residual
    usable = np.isfinite(residuals).all(axis=1) & np.isfinite(poses).all(axis=(1, 2))
    gains, moves = np.full(len(observations.captures), np.nan), {}
    for number in np.unique(observations.group[usable]):
        rows = usable & (observations.group == number)
        jacobian, residual = poses[rows].reshape(-1, poses.shape[-1]), residuals[rows].ravel()
        if len(residual) < 4 * poses.shape[-1]:
            continue
        pose = np.linalg.lstsq(jacobian, residual, rcond=None)[0]
        left = residual - jacobian @ pose
        gains[number] = (residual @ residual - left @ left) / poses.shape[-1]
        moves[number] = (pose, np.sqrt(np.mean(residual**2)), np.sqrt(np.mean(left**2)))
    apart = np.flatnonzero(gains > np.maximum(_SIGNIFICANT, _APART * np.nanmedian(gains)))
    if len(apart) > max(1, _MOST * len(observations.captures)):
        return []
    plausible = [p.plausible for name in _POSE for p in CAUSES[name].parameters]
    found = []
    for number in apart:
        pose, before, after = moves[number]
        values = [float(v) for v in pose * plausible]
        capture = observations.captures[number]
        found.append(MovedCapture(capture, tuple(values[:3]), tuple(values[3:]), float(before), float(after)))
    return found


def kept(predictor: Predictor, outliers: Sequence[MovedCapture]) -> NDArray[np.bool_]:
    """Mask (n,) of the readings that no outlier has."""
    observations = predictor.observations
    aside = {outlier.capture for outlier in outliers}
    bad = [number for number, name in enumerate(observations.captures) if name in aside]
    return ~np.isin(observations.group, bad)


def _hypothesis(name: str) -> Hypothesis:
    return Hypothesis(CAUSES[name], next(iter(CAUSES[name].variants)))
