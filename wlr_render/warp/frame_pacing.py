"""Pacing of frames: times to begin a frame so that it is finished just before the display shows it.

A frame that begins too early is drawn for an old pose; one that begins too late misses its beat.
"""

import math
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from wlr_render.geometry.pose_prediction import LONGEST_S
from wlr_render.warp.checks import checked_number

_REMEMBERED = 16
"""Number of frames whose second-longest duration is planned for, so that a single hitch has no effect."""
_GAIN = 0.1
"""Share of the difference to a reported beat by which beats are moved, per beat since then: jitter averages out."""


@dataclass(frozen=True)
class FrameTimes:
    """Times of one frame, in seconds of the pacer's clock.

    Attributes:
        begin_s: time to read the trackers and call `Compositor.begin_frame`.
        display_s: beat at which the frame is shown.
    """

    begin_s: float
    display_s: float

    @property
    def ahead_s(self) -> float:
        """Time from the beginning to the display, at most 0.1 s: `predict_s` of `Compositor.begin_frame`."""
        return min(self.display_s - self.begin_s, LONGEST_S)


class FramePacer:
    """Plans frames for a display that shows pictures at regular beats; one thread may use it at a time.

    A program that cannot keep the beat is paced at every second beat, or third: let another thread compose at each,
    and pass the times of its scan-outs to the pacer's thread (docs/realtime.md). A runtime of OpenXR paces its
    programs in xrWaitFrame.
    """

    def __init__(self, period_s: float, margin_s: float = 1e-3, clock: Callable[[], float] = time.perf_counter) -> None:
        """Plan for beats of a period, about 1/72 to 1/120 s, from now on.

        Args:
            period_s: 1e-3 to 1 s.
            margin_s: time by which a frame should be finished before its beat, 0 to a period.
            clock: function that returns the time in seconds, the clock of all times here.

        Raises:
            BadInputError: numbers outside these ranges.
        """
        self._period_s = checked_number(period_s, "period_s", 1e-3, 1)
        self._margin_s = checked_number(margin_s, "margin_s", 0, self._period_s)
        self._clock, self._beat_s, self._is_reported = clock, clock(), False
        self._durations_s: deque[float] = deque([self._period_s / 2], maxlen=_REMEMBERED)
        self._frame: FrameTimes | None = None

    def shown(self, at_s: float) -> None:
        """Report a past beat: the time of a scan-out's first row, whenever it is known."""
        at_s = checked_number(at_s, "at_s", -math.inf, math.inf)
        beats = round((at_s - self._beat_s) / self._period_s)
        off_s = at_s - (self._beat_s + beats * self._period_s)
        self._beat_s = at_s - (off_s * (1 - _GAIN) ** max(beats, 1) if self._is_reported else 0.0)
        self._is_reported = True

    def next_frame(self) -> FrameTimes:
        """Plan the next frame, for the first reachable beat after the last frame's.

        Sleep until its `begin_s`, and call `finished` when its pictures are submitted.
        """
        needed_s, now_s = sorted(self._durations_s)[-2:][0] + self._margin_s, self._clock()
        earliest_s = now_s + needed_s
        if self._frame is not None:
            earliest_s = max(earliest_s, self._frame.display_s + self._period_s / 2)
        display_s = self._beat_s + math.ceil((earliest_s - self._beat_s) / self._period_s) * self._period_s
        self._frame = FrameTimes(max(display_s - needed_s, now_s), display_s)
        return self._frame

    def finished(self, frame: FrameTimes) -> None:
        """Report that a frame's pictures are now submitted; its duration counts for later frames."""
        self._durations_s.append(max(self._clock() - frame.begin_s, 0.0))
