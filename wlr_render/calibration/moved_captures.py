"""Camera motions: fitted versus stated sizes, and odds that a camera moved by more than a stage's repeatability."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np

from wlr_render.calibration.readings import FitReadings
from wlr_render.calibration.smooth_prior import SHIFT, TURN, motion_scale, motion_sizes
from wlr_render.numerics.arrays import FloatArray, IntArray
from wlr_render.usual import STAGE_REPEATABILITY_M, STAGE_TURN_RAD

_TIMES_USUAL = (1.0, 5.0, 20.0, 100.0, 500.0)  # sizes of a moved camera's shift and turn, in usual sizes
_SMOOTH_TIMES_USUAL = (1.0, 10.0, 100.0, 1e3, 1e4)  # sizes of smooth motions, up to the largest plausible ones
_SMOOTH_LENGTHS = (0.5, 1.0, 2.0, 4.0, 8.0)  # correlation lengths of smooth motions, in extents of the places
_NEGLIGIBLE = 1e-6  # share of the largest variance below which a smooth function is left out
_SHARE_THAT_MOVES = 0.03  # prior share of captures that move, an assumption as in diagnosis
_SUSPECT_LOG10_ODDS, _UNSURE_LOG10_ODDS, _LEAST_LOG10_ODDS = -2.0, 1.0, 2.0
"""Log10 odds for a test by the other captures, for a warning, and for exclusion."""
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
        """True if the odds that the camera moved are high enough to leave its capture out."""
        return self.is_suspect and self.log10_odds > _LEAST_LOG10_ODDS

    @property
    def is_unsure(self) -> bool:
        """True if the camera probably moved, at odds too low to leave its capture out."""
        return self.is_suspect and _UNSURE_LOG10_ODDS < self.log10_odds <= _LEAST_LOG10_ODDS


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
    motion: FloatArray, covariance: FloatArray, size: FloatArray, usual: FloatArray, place: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return log10 odds (captures,) that each camera moved more than usual, and the likeliest motions (captures, 6).

    Optics that are less smooth than the fit look like motions that vary smoothly over the place. Size and length of
    such motions are averaged over, with and without a moved camera: if the places are too few to distinguish both, the
    odds are low.

    Args:
        motion: (captures, 6) posterior mean.
        covariance: (6 * captures, 6 * captures) posterior covariance.
        size: (captures, 6) prior sizes used in the posterior.
        usual: (captures, 6) motion sizes of cameras that did not move.
        place: (captures, variables) places of the captures.
    """
    scale = np.repeat(list(product(_TIMES_USUAL, repeat=2)), 3, axis=1)
    still, moved, most, likeliest = [], [], np.full(len(motion), -np.inf), motion
    for evidence, mean, within in _own_motions(motion, covariance, size, usual, place):
        logs, means = _by_scale(mean, within, size, usual, scale)
        still.append(evidence + logs[:, 0])
        moved.append(evidence + np.logaddexp.reduce(logs[:, 1:], axis=1) - np.log(len(scale) - 1))
        best = 1 + np.argmax(logs[:, 1:], axis=1)
        height = evidence + np.take_along_axis(logs, best[:, None], axis=1)[:, 0]
        means = means[np.arange(len(best)), best]
        likeliest, most = np.where((height > most)[:, None], means, likeliest), np.maximum(height, most)
    odds = np.logaddexp.reduce(moved) - np.logaddexp.reduce(still) + np.log(_SHARE_THAT_MOVES)
    return odds / np.log(10.0), likeliest


def _own_motions(
    motion: FloatArray, covariance: FloatArray, size: FloatArray, usual: FloatArray, place: FloatArray
) -> Iterator[tuple[float, FloatArray, FloatArray]]:
    """Yield posteriors of the motions beside smooth motions of each size and length, first without smooth motions.

    Each is the log evidence relative to the first, the mean (captures, 6) and the captures' covariances (captures, 6,
    6). Arguments are those of `moved_odds`.
    """
    blocks = 6 * np.arange(len(motion))[:, None] + np.arange(6)
    within = covariance[blocks[:, :, None], blocks[:, None]]
    yield 0.0, motion, within
    unit = np.repeat([np.sqrt(np.mean(usual[:, part] ** 2)) for part in (SHIFT, TURN)], 3)
    precision = size.ravel() ** -2.0
    extent = max(float(np.ptp(place, axis=0).max()), 1e-300)
    square = np.sum((place[:, None] - place) ** 2, axis=2) / extent**2
    for length in _SMOOTH_LENGTHS:
        variance, functions = np.linalg.eigh(np.exp(-0.5 * square / length**2))
        used = variance > _NEGLIGIBLE * variance[-1]
        smooth = np.kron(functions[:, used] * np.sqrt(variance[used]), np.diag(unit))
        # The readings know the sum of own and smooth motions, and the posterior has attributed it to the own ones.
        left = smooth - covariance @ (precision[:, None] * smooth)
        pull, information = smooth.T @ (precision * motion.ravel()), smooth.T @ (precision[:, None] * left)
        for times in product(_SMOOTH_TIMES_USUAL, repeat=2):
            by = np.tile(np.repeat(times, 3), int(used.sum()))
            normal = np.eye(len(by)) + by[:, None] * (0.5 * (information + information.T)) * by
            values, axes = np.linalg.eigh(normal)
            values = np.maximum(values, 1.0)  # smaller values are rounding errors
            half = (by * pull) @ axes / np.sqrt(values)
            by_capture = ((left * by) @ axes / np.sqrt(values)).reshape(len(motion), 6, -1)
            evidence = 0.5 * float(half @ half - np.log(values).sum())
            yield evidence, motion - by_capture @ half, within + by_capture @ by_capture.transpose(0, 2, 1)


def _by_scale(
    motion: FloatArray, within: FloatArray, size: FloatArray, usual: FloatArray, scale: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the log evidence (captures, scales) of motions of other sizes, and their means (captures, scales, 6).

    The evidence is relative to motions of size `size`.

    Args:
        motion, size, usual: as in `moved_odds`. within: (captures, 6, 6) posterior covariance.
        scale: (scales, 6) motion sizes in usual sizes.
    """
    mean, within = motion / usual, within / usual[:, :, None] / usual[:, None]
    within = within + 1e-9 * within * np.eye(6)
    precision = np.linalg.inv(within)
    information = precision - (usual / size)[:, :, None] ** 2 * np.eye(6)
    values, axes = np.linalg.eigh(0.5 * (information + information.transpose(0, 2, 1)))
    # Negative values are rounding errors.
    information = (axes * np.maximum(values, 0.0)[:, None]) @ axes.transpose(0, 2, 1)
    scales = np.concatenate([np.broadcast_to(scale, (len(size), *scale.shape)), (size / usual)[:, None]], axis=1)
    pull = scales * np.einsum("cij,cj->ci", precision, mean)[:, None]
    normal = np.eye(6) + scales[..., None] * information[:, None] * scales[:, :, None]
    own = np.linalg.solve(normal, pull[..., None])[..., 0]
    logs = 0.5 * (np.sum(pull * own, axis=2) - np.linalg.slogdet(normal)[1])
    return logs[:, :-1] - logs[:, -1:], (usual[:, None] * scales * own)[:, :-1]
