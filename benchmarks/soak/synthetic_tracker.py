"""Synthetic eye tracker for a known eye movement. For tests and demonstrations, not as evidence."""

import numpy as np
from numpy.random import Generator

from wlr_render.numerics.arrays import FloatArray
from wlr_render.tracking.samples import require_ascending
from wlr_render.tracking.trajectory import EYES, EyeTrajectory

_BLINK_INTERVAL_S = (1.0, 60.0 / 17.0)  # shortest interval (our assumption); mean at rest (Bentivoglio et al. 1997)
_PUPIL_HIDDEN_S = (0.1, 0.3)  # a blink covers the eye for at most 300 ms (Stern, Walrath & Goldstein 1984)
_PUPIL_RADIUS_M = 0.002
_CLOSING_S = 0.025  # time for 4 mm at 17-20 cm/s (Doane 1980)
_OPENING_S = 0.04  # closing is 40-47 % quicker (Sforza et al. 2008)
_DROPOUT_INTERVAL_S = (1.0, 5.0)  # shortest and mean interval, our assumption
_DROPOUT_S = (0.005, 0.05)  # shortest and longest dropout, our assumption


def tracker_samples(eyes: EyeTrajectory, time_s: FloatArray, seed: int) -> dict[str, list[FloatArray | None]]:
    """Return a tracker's samples at times (n,), per eye: the entrance pupil (3,), device frame, metres, or None.

    Both eyes blink together. A lid that moves down or up across the pupil at constant speed shifts the centre of the
    pupil's visible part down (-y), by the pupil's radius when all is covered; the sample is then missing. In addition,
    each eye has its own short dropouts. Blinks and dropouts depend on the seed and the first time only.

    Args:
        eyes: the true movement.
        time_s: (n,) ascending times within the trajectory, n >= 2.
        seed: seed of blinks and dropouts.

    Raises:
        BadInputError: times that do not ascend, fewer than two, or outside the trajectory.
    """
    require_ascending(time_s, "moments of the eye tracker")
    truth = {eye: eyes.viewpoint_at(eye, time_s) for eye in eyes.tracks}
    since_start_s = time_s - time_s[0]
    blinks = _spells(np.random.default_rng(seed), since_start_s[-1], _BLINK_INTERVAL_S, _PUPIL_HIDDEN_S)
    covered = _covered_share(since_start_s, blinks)
    samples: dict[str, list[FloatArray | None]] = {}
    for eye, viewpoint in truth.items():
        own_rng = np.random.default_rng([seed, 1 + EYES.index(eye)])
        dropouts = _spells(own_rng, since_start_s[-1], _DROPOUT_INTERVAL_S, _DROPOUT_S)
        lost = (covered >= 1.0) | (since_start_s <= _end_before(since_start_s, dropouts))
        seen = viewpoint - covered[:, None] * [0.0, _PUPIL_RADIUS_M, 0.0]
        samples[eye] = [None if gone else point for gone, point in zip(lost, seen, strict=True)]
    return samples


def _spells(
    rng: Generator, span_s: float, interval_s: tuple[float, float], length_s: tuple[float, float]
) -> FloatArray:
    """Draw starts and ends (m, 2) of random events; intervals are the shortest interval plus an exponential part."""
    shortest_s, mean_s = interval_s
    uniform = rng.random((int(span_s / shortest_s) + 1, 2))  # row by row: a longer span starts with the same events
    start_s = np.cumsum(shortest_s - (mean_s - shortest_s) * np.log1p(-uniform[:, 0]))
    return np.stack([start_s, start_s + length_s[0] + uniform[:, 1] * (length_s[1] - length_s[0])], axis=1)


def _end_before(time_s: FloatArray, spells: FloatArray) -> FloatArray:
    """Return the end (n,) of the last spell that began by each moment; -inf before the first."""
    return np.concatenate([[-np.inf], spells[:, 1]])[np.searchsorted(spells[:, 0], time_s, side="right")]


def _start_after(time_s: FloatArray, spells: FloatArray) -> FloatArray:
    """Return the start (n,) of the next spell after each moment; inf after the last."""
    return np.concatenate([spells[:, 0], [np.inf]])[np.searchsorted(spells[:, 0], time_s, side="right")]


def _covered_share(time_s: FloatArray, blinks: FloatArray) -> FloatArray:
    """Return the share (n,) of the pupil's height that the lid covers: 1 from the start to the end of a blink."""
    closing = 1.0 - (_start_after(time_s, blinks) - time_s) / _CLOSING_S
    opening = 1.0 - (time_s - _end_before(time_s, blinks)) / _OPENING_S
    return np.clip(np.maximum(closing, opening), 0.0, 1.0)
