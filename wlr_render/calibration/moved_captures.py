"""Camera motions: fitted versus stated sizes, and odds that a camera moved by more than a stage's repeatability."""

from dataclasses import dataclass
from itertools import product

import numpy as np

from wlr_render.calibration.readings import FitReadings
from wlr_render.calibration.smooth_prior import SHIFT, TURN, motion_scale, motion_sizes
from wlr_render.numerics.arrays import FloatArray, IntArray
from wlr_render.usual import STAGE_REPEATABILITY_M, STAGE_TURN_RAD

_TIMES_USUAL = (1.0, 5.0, 20.0, 100.0, 500.0)  # sizes of a moved camera's shift and turn, in usual sizes
_SHARE_THAT_MOVES = 0.03  # prior share of captures that move, an assumption as in diagnosis
_SUSPECT_LOG10_ODDS, _LEAST_LOG10_ODDS = 0.0, 2.0  # log10 odds for a test by the other captures, and for a report
_MEDIAN_OF_THREE = 1.538  # median length of three standard normal numbers
_MOVED_M, _MOVED_RAD = 5e-5, 2e-4  # bounds on an ordinary stage's motion: about 20 usual sizes, 2.5 sigmas
_PLAUSIBLE_M, _PLAUSIBLE_RAD = 0.03, 0.1  # largest plausible motions of a camera on a stage
_BAD_STAGE_M, _BAD_STAGE_RAD, _TIMES_STATED = 1e-4, 3e-4, 2.0
"""Largest motions of all captures: a bad stage's repeatability, 30 usual sizes, or this factor on the stated one."""


@dataclass(frozen=True)
class CaptureMotion:
    """A capture whose camera was off its stated position by far more than the other cameras.

    Attributes:
        capture: index of the capture among the readings.
        shift_m, turn_rad: length of the camera's shift, and its rotation.
        arcmin: mean error of the capture's readings relative to a prediction from the other captures.
        log10_odds: decimal logarithm of the odds that the camera moved, against noise and ordinary stage motion.
    """

    capture: int
    shift_m: float
    turn_rad: float
    arcmin: float
    log10_odds: float

    @property
    def is_suspect(self) -> bool:
        """True if the camera may have moved by more than an ordinary stage's error and by a plausible amount."""
        is_moved = self.shift_m > _MOVED_M or self.turn_rad > _MOVED_RAD
        is_plausible = self.shift_m < _PLAUSIBLE_M and self.turn_rad < _PLAUSIBLE_RAD
        return self.log10_odds > _SUSPECT_LOG10_ODDS and is_moved and is_plausible

    @property
    def stands_out(self) -> bool:
        """True if the odds that the camera moved are high enough to report it."""
        return self.is_suspect and self.log10_odds > _LEAST_LOG10_ODDS


@dataclass(frozen=True)
class MotionAgreement:
    """Comparison of stated and fitted camera motions.

    Attributes:
        shift_m, turn_rad: stated sizes, rms per axis over all captures.
        shift_factor, turn_factor: ratio of fitted to stated size.
        shift_sigmas, turn_sigmas: distance from 0 of the factors' logarithms estimated from readings alone, in standard
            deviations that combine the uncertainties of the stated sizes and of the readings.
    """

    shift_m: float
    turn_rad: float
    shift_factor: float
    turn_factor: float
    shift_sigmas: float
    turn_sigmas: float


def usual_motion(readings: FitReadings, factors: FloatArray, motion: FloatArray, others: IntArray) -> FloatArray:
    """Return motion sizes (captures, 6) for captures that did not move: fitted or, if smaller, from the median motion.

    Args:
        readings: the fitted readings.
        factors: (6,) fitted sizes over the sizes of `motion_sizes`.
        motion: (captures, 6) fitted motions. others: captures that are not left out.
    """
    stated = motion_sizes(readings)
    usual = stated * factors
    parts = (SHIFT, STAGE_REPEATABILITY_M.value, _BAD_STAGE_M), (TURN, STAGE_TURN_RAD.value, _BAD_STAGE_RAD)
    for (part, least, bad), scale in zip(parts, motion_scale(readings), strict=True):
        relative = np.linalg.norm(motion[others, part] / usual[others, part], axis=1)
        most = float(np.max(factors[part]) * np.median(relative)) / _MEDIAN_OF_THREE
        if readings.motion_prior is not None:
            most = max(most, 1.0)
        # No stage is worse than this limit: if all captures seem to have moved, only a few have.
        usual[:, part] = np.minimum(usual[:, part], stated[:, part] * min(most, max(_TIMES_STATED, bad / scale)))
        usual[:, part] = np.maximum(usual[:, part], least)
    return usual


def moved_odds(
    motion: FloatArray, covariance: FloatArray, size: FloatArray, usual: FloatArray
) -> tuple[float, FloatArray]:
    """Return the log10 odds that a camera moved more than usual, and the most probable motion (6,) in this case.

    Args:
        motion: (6,) posterior mean. covariance: (6, 6) posterior covariance.
        size: (6,) prior sizes used in the posterior.
        usual: (6,) motion sizes of a camera that did not move.
    """
    mean, within = motion / usual, covariance / usual / usual[:, None]
    within = within + 1e-9 * np.diag(np.diag(within))
    precision = np.linalg.inv(within)
    pull, information = precision @ mean, precision - np.diag((usual / size) ** 2)
    scale = np.repeat(list(product(_TIMES_USUAL, repeat=2)), 3, axis=1)
    normal = np.eye(6) + scale[:, :, None] * (0.5 * (information + information.T)) * scale[:, None]
    values, axes = np.linalg.eigh(normal)
    values = np.maximum(values, 1.0)  # smaller values are rounding errors
    along = np.einsum("pki,pk->pi", axes, scale * pull)
    logs = 0.5 * (np.sum(along**2 / values, axis=1) - np.log(values).sum(axis=1))
    means = usual * scale * np.einsum("pki,pi->pk", axes, along / values)
    moved = float(np.logaddexp.reduce(logs[1:])) - np.log(len(logs) - 1)
    odds = float((moved - logs[0] + np.log(_SHARE_THAT_MOVES)) / np.log(10.0))
    return odds, means[1 + int(np.argmax(logs[1:]))]
