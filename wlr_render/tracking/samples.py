"""Interpolation between samples in time."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wlr_render.errors import BadInputError
from wlr_render.numerics.arrays import FloatArray


@dataclass(frozen=True, eq=False)
class Bracket:
    """Time stamps between samples.

    Attributes:
        before: (...) index of the sample at or before each time stamp; the next sample is `before + 1`.
        fraction: (...) position of each time stamp between that sample and the next, 0..1.
    """

    before: NDArray[np.int64]
    fraction: FloatArray

    def pair(self, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the values (..., k) of the samples before and after each time stamp, from values (n, k)."""
        return values[self.before], values[self.before + 1]

    def linear(self, values: FloatArray) -> FloatArray:
        """Interpolate values (n, k) linearly to (..., k); exact at the samples."""
        first, second = self.pair(values)
        weight = self.fraction[..., None]
        return np.asarray((1.0 - weight) * first + weight * second)


def bracket(sample_time_s: FloatArray, time_s: ArrayLike, what: str) -> Bracket:
    """Find the samples around time stamps (...), given ascending sample times (n,), n >= 2.

    Raises:
        BadInputError: a time stamp outside the samples: poses are never extrapolated.
    """
    moment = np.asarray(time_s, dtype=np.float64)
    first, last = sample_time_s[0], sample_time_s[-1]
    outside = ~((moment >= first) & (moment <= last))
    if outside.any():
        raise BadInputError(
            f"{what}: time {moment[outside].flat[0]:.6f} s lies outside its range {first:.6f} to {last:.6f} s."
        )
    before = np.clip(np.searchsorted(sample_time_s, moment, side="right") - 1, 0, len(sample_time_s) - 2)
    start, end = sample_time_s[before], sample_time_s[before + 1]
    return Bracket(np.asarray(before), np.asarray((moment - start) / (end - start)))


GAP = 2.5
"""Interval between samples, in median intervals, above which there is a gap: two or more samples are missing.

A recording of 90 Hz has a gap after 28 ms without a sample; a track of two samples has none."""

_ROUNDING_S = 1e-6


@dataclass(frozen=True, eq=False)
class Gaps:
    """Gaps between samples at time stamps.

    Attributes:
        start_s: (...) time of the last sample before the gap; outside of gaps the time stamp itself.
        length_s: (...) time between the samples around the gap; 0 outside of gaps.
    """

    start_s: FloatArray
    length_s: FloatArray


def gaps_at(sample_time_s: FloatArray, time_s: ArrayLike, invalid_s: FloatArray) -> Gaps:
    """Return the gaps at time stamps (...), given ascending sample times (n,), n >= 2.

    A gap is an interval between neighbouring samples that is longer than GAP median intervals, or contains one of the
    times `invalid_s` (m,) at which the recording has no valid sample.
    """
    moment, step_s = np.asarray(time_s, dtype=np.float64), np.diff(sample_time_s)
    without = step_s > GAP * np.median(step_s)
    after = np.searchsorted(sample_time_s, invalid_s)
    without[after[(after > 0) & (after < len(sample_time_s))] - 1] = True
    before = np.clip(np.searchsorted(sample_time_s, moment, side="right") - 1, 0, len(step_s) - 1)
    start, end = sample_time_s[before], sample_time_s[before + 1]
    inside = without[before] & (moment > start + _ROUNDING_S) & (moment < end - _ROUNDING_S)
    return Gaps(np.where(inside, start, moment), np.where(inside, end - start, 0.0))


def require_ascending(time_s: FloatArray, what: str) -> None:
    """Check that there are at least two samples and that their times ascend strictly."""
    if len(time_s) < 2:
        raise BadInputError(f"{what}: at least two samples are needed to interpolate, not {len(time_s)}.")
    late = np.flatnonzero(~(np.diff(time_s) > 0))
    if late.size:
        row = int(late[0]) + 1
        raise BadInputError(f"{what}: sample {row} at {time_s[row]:.6f} s does not come after the one before it.")
