"""Causal filter from samples of an eye tracker to a viewpoint for every frame, for one eye.

A good sample is used unchanged and at once. The map follows every frame, so a saccade needs no smoothing, and a jump is
not suspicious: an eye reaches hundreds of degrees per second.

A sample that is missing, has low confidence, or has an impossible position is not used:

- A short gap is a fault of the tracker. The last sample is the best estimate and is held.
- Before a blink the lid covers the pupil from above, and the centre of the visible part moves down with the lid. The
  lid passes the visual axis at 17-20 cm/s (Doane 1980), hence a pupil of 4 mm in some 25 ms, and it opens more slowly
  than it closes (Sforza et al. 2008). Blinks read from eyelids are about 60 ms longer than those read from pupils
  (Nyström et al. 2024), which is this time on both sides; the usual remedy is to drop 50 ms on each side (Kret &
  Sjak-Shie 2019). The last *trusted* viewpoint is therefore the median of a short time that ends 50 ms before the gap;
  the viewpoint moves there smoothly. It arrives 100 ms after the last good sample, when most blinks still cover the
  eye (they do for up to 300 ms: Stern, Walrath & Goldstein 1984).
- After a blink the lid also biases the first samples. They are used nevertheless: their error is at most the pupil's
  radius and lasts less than 50 ms, whereas large gaze shifts come with a blink (97 % of those beyond 33 deg: Evinger et
  al. 1994), so that waiting would show the old position, wrong by millimetres. But they are never trusted.

A frozen sensor that repeats its last reading is not distinguished from an eye at rest; holding would give the same
viewpoint. The filter does not check whether a viewpoint lies in the box that a model was fitted on; the caller must
clamp or refuse it.
"""

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from statistics import median

import numpy as np
from numpy.typing import ArrayLike

from wlr_render.errors import BadInputError
from wlr_render.numerics.arrays import FloatArray
from wlr_render.tracking.minimum_jerk import minimum_jerk

BLINK_GAP_S = 0.075
"""Length of a gap (Kret & Sjak-Shie 2019) after which the lid may bias the first samples."""

LID_S = 0.05
"""Time before and after a blink in which the lid may bias the samples."""

MEMORY_S = 0.05
"""Length of the window whose median is the trusted viewpoint: part of one fixation, which lasts 200 ms or longer."""

_Point = tuple[float, float, float]


class TrackingState(IntEnum):
    """State of eye tracking at an update, in the order of the time since the last good sample."""

    TRACKED = 0
    """The viewpoint is the tracker's sample."""
    HELD = 1
    """No good sample has arrived; the viewpoint is the last one."""
    FADING = 2
    """No good sample has arrived for a while; the viewpoint moves to the last trusted one."""
    LOST = 3
    """The eye is lost; the viewpoint is the last trusted one, or the nominal one if there was none."""


@dataclass(frozen=True, eq=False)
class TrackedViewpoint:
    """Viewpoint for a frame, with its tracking state.

    Attributes:
        viewpoint: (3,) entrance pupil, device frame, metres; finite in every state.
        state: state of eye tracking.
    """

    viewpoint: FloatArray
    state: TrackingState


@dataclass(frozen=True)
class StreamCounts:
    """Number of updates in each state.

    Attributes:
        by_state: number of updates, for every state.
    """

    by_state: Mapping[TrackingState, int]

    @property
    def total(self) -> int:
        """Number of all updates."""
        return sum(self.by_state.values())

    @property
    def sentence(self) -> str:
        """The counts as a sentence."""
        counts = ", ".join(f"{self.by_state[state]} {state.name.lower()}" for state in TrackingState)
        return f"{self.total} updates: {counts}"


class ViewpointFilter:
    """Viewpoint filter of one eye."""

    def __init__(
        self,
        nominal_in_device: ArrayLike,
        hold_s: float = 0.05,
        fade_s: float = 0.05,
        reach_m: float = 0.02,
        min_confidence: float = 0.5,
    ) -> None:
        """Start without a sample.

        Args:
            nominal_in_device: (3,) metres, nominal entrance pupil; the viewpoint until the first good sample.
            hold_s: time for which the last good sample is held.
            fade_s: duration of the subsequent move to the last trusted viewpoint.
            reach_m: samples farther than this from the nominal viewpoint are implausible. A pupil 10.5 mm in front of
                the eye's centre moves 9 mm when the eye turns by 50 deg; the rest is for headsets that are not aligned.
            min_confidence: samples below this are ignored.

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
        """Number of updates in each state so far."""
        return StreamCounts(dict(self._counts))

    def update(self, time_s: float, viewpoint_in_device: ArrayLike | None, confidence: float = 1.0) -> TrackedViewpoint:
        """Process one sample, or a missing one, and return the viewpoint for the frame.

        Args:
            time_s: time of the update, not before the last one.
            viewpoint_in_device: (3,) metres; None or not finite if the tracker has no sample.
            confidence: the tracker's confidence, if it states one.

        Raises:
            BadInputError: a time that is not finite or decreases, or a sample that is not three numbers; the
                filter is unchanged.
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
        near = math.dist(sample, self._nominal) <= self._reach_m  # False for NaN
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
    """The latest good samples, except samples that a rising lid may have biased."""

    def __init__(self) -> None:
        self._recent: deque[tuple[float, _Point]] = deque()
        self._suspended_until_s = -math.inf
        self._answer: _Point | None = None

    def suspend_until(self, time_s: float) -> None:
        """Trust no sample before this time."""
        self._suspended_until_s = time_s

    def add(self, time_s: float, sample: _Point) -> None:
        """Add a good sample, and drop samples that are too old to be needed."""
        if time_s >= self._suspended_until_s:
            self._recent.append((time_s, sample))
        while self._recent and self._recent[0][0] < time_s - LID_S - MEMORY_S:
            self._recent.popleft()

    def before_loss(self, loss_s: float) -> _Point | None:
        """Return the median of each coordinate before the lid closed; without samples there, the previous result."""
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
