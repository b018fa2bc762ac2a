"""An eye tracker's samples -> a viewpoint for every frame: one eye, sample by sample, causal.

A good sample is used at once and as it is. The map follows every frame, so a saccade needs no smoothing, and a jump is
no reason to doubt a sample: an eye reaches hundreds of degrees per second.

A sample that is missing, has too little confidence, or lies where no eye can be is not used:

- A short gap is a fault of the tracker, and the last sample is the best guess: it is held.
- Before a blink the lid comes down over the pupil, and the centre of what is left of it moves down with the lid. The
  lid passes the visual axis at 17-20 cm/s (Doane 1980), hence a pupil of 4 mm in some 25 ms, and it opens more slowly
  than it closes (Sforza et al. 2008). Blinks read from eyelids are about 60 ms longer than those read from pupils
  (Nyström et al. 2024), which is this time on both sides; the usual remedy is to drop 50 ms on each side (Kret &
  Sjak-Shie 2019). The last *trusted* viewpoint is therefore the median of a short time that ends 50 ms before the gap;
  the viewpoint moves there smoothly. It arrives 100 ms after the last good sample, when most blinks still cover the
  eye (they do for up to 300 ms: Stern, Walrath & Goldstein 1984).
- After a blink the lid drags the first samples, too. They are drawn nevertheless: their fault is at most the pupil's
  radius and gone within 50 ms, whereas large gaze shifts come with a blink (97 % of those beyond 33 deg: Evinger et al.
  1994), so that waiting would show the old place, off by millimetres. But they are never trusted.

A sensor that is frozen and repeats its last reading is not told apart from an eye at rest: it would be held, and the
viewpoint drawn for would be the same. Whether a viewpoint lies in the box that a model was fitted for is not asked
here; who draws must clamp or refuse.
"""

import math
from collections import deque
from statistics import median

import numpy as np
from numpy.typing import ArrayLike

from wlr_render.errors import BadInputError
from wlr_render.numerics.arrays import FloatArray
from wlr_render.tracking.minimum_jerk import minimum_jerk
from wlr_render.tracking.tracked_viewpoint import StreamCounts, TrackedViewpoint, TrackingState

BLINK_GAP_S = 0.075
"""After a gap longer than this (Kret & Sjak-Shie 2019) the first samples may be dragged by a lid."""

LID_S = 0.05
"""How long before and after a blink the lid may drag the samples."""

MEMORY_S = 0.05
"""How much time the trusted viewpoint is the median of: a part of one fixation, which lasts 200 ms and longer."""

_Point = tuple[float, float, float]


class ViewpointFilter:
    """One eye's viewpoint, from one update to the next."""

    def __init__(
        self,
        nominal_in_device: ArrayLike,
        hold_s: float = 0.05,
        fade_s: float = 0.05,
        reach_m: float = 0.02,
        min_confidence: float = 0.5,
    ) -> None:
        """Start with an eye that was never seen.

        Args:
            nominal_in_device: (3,) metres, where the entrance pupil should be; the viewpoint until a good sample comes.
            hold_s: how long after the last good sample its viewpoint is held.
            fade_s: how long the move to the last trusted viewpoint takes then.
            reach_m: samples farther than this from the nominal viewpoint are implausible. A pupil 10.5 mm in front of
                the eye's centre moves 9 mm when the eye turns by 50 deg; the rest is for headsets that sit askew.
            min_confidence: samples with less are not used.

        Raises:
            BadInputError: a nominal viewpoint that is not three finite numbers, a negative or infinite hold_s, a fade_s
                or reach_m that is not positive and finite, a min_confidence that is not a number.
        """
        nominal = _point(nominal_in_device)
        if not all(map(math.isfinite, nominal)):
            raise BadInputError(f"nominal viewpoint {nominal} is not finite; give the entrance pupil in metres.")
        if not 0 <= hold_s < math.inf:
            raise BadInputError(f"hold_s is {hold_s}; give a time in seconds, 0 or more.")
        if not (0 < fade_s < math.inf and 0 < reach_m < math.inf):
            raise BadInputError(f"fade_s is {fade_s} and reach_m is {reach_m}; both must be positive and finite.")
        if math.isnan(min_confidence):
            raise BadInputError("min_confidence is NaN; give the least confidence of a usable sample.")
        self._nominal, self._hold_s, self._fade_s = nominal, hold_s, fade_s
        self._reach_m, self._min_confidence = reach_m, min_confidence
        self._time_s = -math.inf
        self._last: tuple[float, _Point] | None = None
        self._fade_end: _Point | None = None
        self._trusted = _TrustedSamples()
        self._counts = dict.fromkeys(TrackingState, 0)

    @property
    def counts(self) -> StreamCounts:
        """How many updates ended in which state so far."""
        return StreamCounts(dict(self._counts))

    def update(self, time_s: float, viewpoint_in_device: ArrayLike | None, confidence: float = 1.0) -> TrackedViewpoint:
        """Take the sample of a moment, or the news that there is none, and say what to draw for.

        Args:
            time_s: not before the last update's.
            viewpoint_in_device: (3,) metres; None or not finite where the tracker has nothing.
            confidence: the tracker's own, if it states one.

        Raises:
            BadInputError: a time that is not finite or runs backwards, a sample that is not of three numbers; the
                filter is left as it was.
        """
        if not math.isfinite(time_s):
            raise BadInputError(f"time of an eye sample is {time_s}; give seconds on a clock that only moves forward.")
        if time_s < self._time_s:
            raise BadInputError(f"eye sample at {time_s} s comes after one at {self._time_s} s; give them in order.")
        sample = None if viewpoint_in_device is None else _point(viewpoint_in_device)
        self._time_s = float(time_s)
        if sample is not None and self._is_good(sample, confidence):
            point, state = self._follow(sample)
        else:
            point, state = self._bridge()
        self._counts[state] += 1
        return TrackedViewpoint(np.array(point), state)

    def _is_good(self, sample: _Point, confidence: float) -> bool:
        near = math.dist(sample, self._nominal) <= self._reach_m  # NaN is not
        return near and confidence >= self._min_confidence

    def _follow(self, sample: _Point) -> tuple[_Point, TrackingState]:
        if self._last is not None and self._time_s - self._last[0] > BLINK_GAP_S:
            self._trusted.suspend_until(self._time_s + LID_S)
        self._trusted.add(self._time_s, sample)
        self._last, self._fade_end = (self._time_s, sample), None
        return sample, TrackingState.TRACKED

    def _bridge(self) -> tuple[_Point, TrackingState]:
        if self._last is None:
            return self._nominal, TrackingState.LOST
        last_s, last = self._last
        fading_s = self._time_s - last_s - self._hold_s
        if fading_s <= 0:
            return last, TrackingState.HELD
        if self._fade_end is None:
            self._fade_end = self._trusted.before_loss(last_s) or last
        if fading_s >= self._fade_s:
            return self._fade_end, TrackingState.LOST
        share = minimum_jerk(fading_s / self._fade_s)
        x, y, z = ((1.0 - share) * start + share * end for start, end in zip(last, self._fade_end, strict=True))
        return (x, y, z), TrackingState.FADING


class _TrustedSamples:
    """The good samples of the last moments, without those that a rising lid may have dragged."""

    def __init__(self) -> None:
        self._recent: deque[tuple[float, _Point]] = deque()
        self._suspended_until_s = -math.inf
        self._answer: _Point | None = None

    def suspend_until(self, time_s: float) -> None:
        """Trust no sample before this moment."""
        self._suspended_until_s = time_s

    def add(self, time_s: float, sample: _Point) -> None:
        """Take a good sample; forget those too old to be asked for."""
        if time_s >= self._suspended_until_s:
            self._recent.append((time_s, sample))
        while self._recent and self._recent[0][0] < time_s - LID_S - MEMORY_S:
            self._recent.popleft()

    def before_loss(self, loss_s: float) -> _Point | None:
        """The median of each coordinate before the lid came down; without a sample there, the answer before."""
        samples = [sample for time_s, sample in self._recent if time_s <= loss_s - LID_S]
        if samples:
            x, y, z = (median(values) for values in zip(*samples, strict=True))
            self._answer = (x, y, z)
        return self._answer


def _point(viewpoint: ArrayLike) -> _Point:
    try:
        values: FloatArray = np.asarray(viewpoint, dtype=np.float64)
    except (TypeError, ValueError):
        values = np.empty(0)
    if values.shape != (3,):
        raise BadInputError(f"viewpoint {viewpoint!r} is not of three numbers; give x, y, z in metres, or None.")
    x, y, z = values.tolist()
    return x, y, z
