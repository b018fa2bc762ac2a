"""Viewpoint for a frame, with the state of eye tracking."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum

from wlr_render.numerics.arrays import FloatArray


class TrackingState(IntEnum):
    """State of eye tracking at an update, in the order of the time since the last good sample."""

    TRACKED = 0
    HELD = 1
    FADING = 2
    LOST = 3

    @property
    def sentence(self) -> str:
        """The state in words."""
        return _SENTENCES[self]


_SENTENCES = {
    TrackingState.TRACKED: "the viewpoint is the tracker's sample",
    TrackingState.HELD: "there is no good sample; the viewpoint is the last one",
    TrackingState.FADING: "there has been no good sample for a while; the viewpoint moves to the last trusted one",
    TrackingState.LOST: "the eye is lost; the viewpoint is the last trusted one, or the nominal one if there was none",
}


@dataclass(frozen=True, eq=False)
class TrackedViewpoint:
    """Viewpoint for a frame, with its tracking state.

    Attributes:
        viewpoint: (3,) entrance pupil, device frame, metres; finite in every state.
        state: of eye tracking.
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
        """The counts in words."""
        counts = ", ".join(f"{self.by_state[state]} {state.name.lower()}" for state in TrackingState)
        return f"{self.total} updates: {counts}"
