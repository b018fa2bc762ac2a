"""Whole captures that moved: coherent residuals of one photograph that no change of the bench as a whole explains."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from wlr_render.diagnosis.causes import CAUSES
from wlr_render.diagnosis.fit import Fit, reduced_chi_squared
from wlr_render.diagnosis.observations import SEE_THROUGH, CaptureName, Observations
from wlr_render.diagnosis.prediction import Hypothesis, Predictor
from wlr_render.diagnosis.settings import DEFAULT, Settings
from wlr_render.numerics.arrays import BoolArray, FloatArray

_POSE = ("camera_pupil_offset", "camera_rotation")


@dataclass(frozen=True)
class MovedCapture:
    """An excluded capture.

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


def moved_captures(predictor: Predictor, fit: Fit, good: BoolArray, settings: Settings = DEFAULT) -> list[MovedCapture]:
    """Captures that stand out from all others after a fit, by the gain of a camera pose of their own.

    A run-time recording has no camera pose, and is never excluded.

    Args:
        predictor: of all readings.
        fit: to those that counted so far.
        good: (n,) readings that are no outliers by themselves.
        settings: thresholds.
    """
    observations = predictor.observations
    state = predictor.state(fit.explanation)
    columns = [predictor.added(state, fit.explanation.plus(_hypothesis(name))) for name in _POSE]
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
    usual = middle + settings.moved_capture_spread * 1.48 * np.nanmedian(np.abs(root - middle))
    apart = np.flatnonzero((gains > settings.moved_capture_gain * max(1.0, reduced_chi_squared(fit))) & (root > usual))
    if len(apart) > max(2, settings.max_moved_captures * len(observations.captures)):
        return []
    return [_moved(observations, int(number), *moves[int(number)]) for number in apart]


def _moved(observations: Observations, number: int, pose: FloatArray, before: float, after: float) -> MovedCapture:
    name, plan = observations.captures[number], observations.session.plan.see_through
    if name.part == SEE_THROUGH and plan is not None and plan.bare_pixel is not None:
        return MovedCapture(name, None, None, before, after)
    values = pose * [parameter.prior_sigma for cause in _POSE for parameter in CAUSES[cause].parameters]
    return MovedCapture(name, tuple(values[:3].tolist()), tuple(values[3:].tolist()), before, after)


def not_excluded(predictor: Predictor, excluded: Sequence[MovedCapture]) -> BoolArray:
    """Mask (n,) of the readings of captures that are not excluded."""
    observations = predictor.observations
    names = {each.capture for each in excluded}
    bad = [number for number, name in enumerate(observations.captures) if name in names]
    return ~np.isin(observations.group, bad)


def _hypothesis(name: str) -> Hypothesis:
    return Hypothesis(CAUSES[name], next(iter(CAUSES[name].variants)))
