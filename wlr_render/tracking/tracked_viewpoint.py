"""A viewpoint to draw for, and how it is known."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum

from wlr_render.numerics.arrays import FloatArray


class TrackingState(IntEnum):
    """How the viewpoint of an update is known; ascending with the time since the last good sample."""

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
    """What to draw a frame for.

    Attributes:
        viewpoint: (3,) entrance pupil, device frame, metres; finite in every state.
        state: how it is known.
    """

    viewpoint: FloatArray
    state: TrackingState


@dataclass(frozen=True)
class StreamCounts:
    """How often each state occurred in a stream.

    Attributes:
        by_state: number of updates, for every state.
    """

    by_state: Mapping[TrackingState, int]

    @property
    def total(self) -> int:
        """All updates."""
        return sum(self.by_state.values())

    @property
    def sentence(self) -> str:
        """The counts in words."""
        counts = ", ".join(f"{self.by_state[state]} {state.name.lower()}" for state in TrackingState)
        return f"{self.total} updates: {counts}"
