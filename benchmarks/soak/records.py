"""Records of a stream and of each of its frames."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from wlr_render.mappings import Status
from wlr_render.numerics.arrays import FloatArray
from wlr_render.tracking.viewpoint_filter import TrackingState

SACCADE_MM = 1.0
"""Motion of a viewpoint from one frame to the next above which it counts as a jump."""

_NOT_CONVERGED = Status.NOT_CONVERGED.name.lower().replace("_", " ")


@dataclass(frozen=True, eq=False)
class EyeMoment:
    """One eye at one moment.

    Attributes:
        viewpoint: (3,) viewpoint to draw for, device frame, metres.
        state: tracking state of the viewpoint.
        moved_mm: distance from the previous moment's viewpoint.
        brought_back: whether it was outside the model's range and replaced by the nearest viewpoint inside.
    """

    viewpoint: FloatArray
    state: TrackingState
    moved_mm: float
    brought_back: bool

    @property
    def jumped(self) -> bool:
        """True if the viewpoint moved by a distance typical of saccades."""
        return self.moved_mm > SACCADE_MM


@dataclass(frozen=True, eq=False)
class StreamFrame:
    """Trackers' state for one frame.

    Attributes:
        time_s: time of the trajectories.
        world_from_device: (4, 4) head pose when the frame begins.
        at_scan_out: (4, 4) head pose when the panels light up.
        eyes: viewpoint of each eye, by name.
        head_lost: True while the head tracker has lost the head; the poses are then the last good pose.
    """

    time_s: float
    world_from_device: FloatArray
    at_scan_out: FloatArray
    eyes: Mapping[str, EyeMoment]
    head_lost: bool = False

    @property
    def viewpoints(self) -> dict[str, FloatArray]:
        """(3,) by eye."""
        return {name: eye.viewpoint for name, eye in self.eyes.items()}

    @property
    def jumped(self) -> bool:
        """True if any eye jumped."""
        return any(eye.jumped for eye in self.eyes.values())


@dataclass(frozen=True)
class Cost:
    """Time and memory of a frame.

    Attributes:
        draw_ms: `begin_frame`, the scene for all eyes, `submit`.
        compose_ms: `compose`: the maps for the new viewpoints, and the warp.
        cpu_ms: CPU time of all threads of the process.
        collecting_ms: time of Python's garbage collector in the thread that draws.
        preempted: number of involuntary context switches of the process.
        resident_mb: memory of the process after the frame.
    """

    draw_ms: float
    compose_ms: float
    cpu_ms: float
    collecting_ms: float
    preempted: int
    resident_mb: float

    @property
    def frame_ms(self) -> float:
        """Total time of the frame, by the clock."""
        return self.draw_ms + self.compose_ms


@dataclass(frozen=True, eq=False)
class FrameNote:
    """Records of one frame.

    Attributes:
        moment: state of the trackers for the frame.
        cost: time and memory of the frame.
        unsolved: points of the field without a valid solution, by eye and reason.
    """

    moment: StreamFrame
    cost: Cost
    unsolved: Mapping[str, Mapping[str, int]]

    def not_converged(self, eye: str) -> int:
        """Count the points of an eye's field whose solve did not converge."""
        return self.unsolved[eye].get(_NOT_CONVERGED, 0)


@dataclass(frozen=True)
class MapCheck:
    """One eye's map in one frame against the exact solve for the same viewpoint.

    The error is the largest angle, at the viewpoint, between points on both rays from 0.25 m away to infinity.

    Attributes:
        time_s: time of the frame.
        eye: name of the eye.
        moved_mm: motion of the viewpoint since the previous frame.
        kept_arcmin: error of the previous frame's map.
        own_arcmin: error of the frame's own map.
        one_sided: number of points at which only one of the frame's own map and the exact map has a ray.
    """

    time_s: float
    eye: str
    moved_mm: float
    kept_arcmin: float
    own_arcmin: float
    one_sided: int


@dataclass(frozen=True, eq=False)
class Stream:
    """All frames of a stream; the first frame is a warm-up.

    Attributes:
        frames: two or more frames in time order.
        checks: checks of some frames' maps.
        frames_per_second: frame rate of the trajectories.
        late_ms: time from a frame's head pose to its scan-out.
        renderer: name of the renderer.
        size_px: (width, height) of each eye's picture.
    """

    frames: Sequence[FrameNote]
    checks: Sequence[MapCheck]
    frames_per_second: float
    late_ms: float
    renderer: str
    size_px: tuple[int, int]

    @property
    def eyes(self) -> tuple[str, ...]:
        """Names of the eyes."""
        return tuple(self.frames[0].moment.eyes)

    def moments(self, eye: str) -> list[EyeMoment]:
        """Return the moments of one eye in all frames."""
        return [frame.moment.eyes[eye] for frame in self.frames]

    def jumps(self) -> list[tuple[FrameNote, str]]:
        """Return the frames and eyes whose viewpoint has jumped."""
        return [(frame, eye) for frame, eye in self._each() if frame.moment.eyes[eye].jumped]

    def dropped(self) -> list[tuple[FrameNote, str]]:
        """Return the frames and eyes in which some point's solve did not converge."""
        return [(frame, eye) for frame, eye in self._each() if frame.not_converged(eye)]

    def resident_mb(self) -> tuple[float, float]:
        """Return the median memory over the second and over the last tenth of the frames."""
        resident = np.array([frame.cost.resident_mb for frame in self.frames])
        tenth = max(1, len(resident) // 10)
        return float(np.median(resident[tenth : 2 * tenth])), float(np.median(resident[-tenth:]))

    def _each(self) -> Iterable[tuple[FrameNote, str]]:
        return ((frame, eye) for frame in self.frames for eye in self.eyes)
