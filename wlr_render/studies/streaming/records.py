"""What is noted of each frame of a stream."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from wlr_render.mappings import FloatArray
from wlr_render.tracking.tracked_viewpoint import StreamCounts, TrackingState

SACCADE_MM = 1.0
"""A viewpoint that moves farther than this from one frame to the next has jumped."""


@dataclass(frozen=True)
class FrameNote:
    """One frame.

    Attributes:
        time_s: of the trajectories.
        draw_ms: `begin_frame`, the scene for all eyes, `submit`.
        compose_ms: `compose`: the maps for the new viewpoints, and the warp.
        states: by eye, how its viewpoint was known.
        moved_mm: by eye, from the viewpoint of the frame before.
        unsolved: by eye, points of the field without a proper answer, by what is the matter.
        brought_back: eyes whose viewpoint lay beyond the models' reach and was replaced by the nearest within.
        resident_mb: memory of the process.
    """

    time_s: float
    draw_ms: float
    compose_ms: float
    states: Mapping[str, TrackingState]
    moved_mm: Mapping[str, float]
    unsolved: Mapping[str, Mapping[str, int]]
    brought_back: tuple[str, ...]
    resident_mb: float

    @property
    def frame_ms(self) -> float:
        """All of it."""
        return self.draw_ms + self.compose_ms

    def not_converged(self, eye: str) -> int:
        """Points of an eye's field whose solve did not converge."""
        return self.unsolved[eye].get("not converged", 0)


@dataclass(frozen=True)
class Stream:
    """All frames of a stream, the first one warming up.

    Attributes:
        frames: in time order.
        eyes: names.
        counts: by eye, how often its tracker was in which state.
        renderer: what drew.
        size_px: (width, height) of each eye's picture.
    """

    frames: Sequence[FrameNote]
    eyes: tuple[str, ...]
    counts: Mapping[str, StreamCounts]
    renderer: str
    size_px: tuple[int, int]

    def times_ms(self, part: str) -> FloatArray:
        """(n,) of "draw_ms", "compose_ms" or "frame_ms", without the first frame."""
        return np.array([getattr(frame, part) for frame in self.frames[1:]])

    def dropped(self) -> list[tuple[FrameNote, str]]:
        """Frames and eyes in which some point's solve did not converge."""
        return [(frame, eye) for frame in self.frames for eye in self.eyes if frame.not_converged(eye)]

    def jumps(self) -> list[tuple[FrameNote, str]]:
        """Frames and eyes whose viewpoint has jumped."""
        return [(frame, eye) for frame in self.frames for eye in self.eyes if frame.moved_mm[eye] > SACCADE_MM]

    def memory_growth_mb(self) -> float:
        """Resident memory: median of the last tenth of the frames, less that of the second tenth."""
        resident = np.array([frame.resident_mb for frame in self.frames])
        tenth = max(1, len(resident) // 10)
        return float(np.median(resident[-tenth:]) - np.median(resident[tenth : 2 * tenth]))
