"""Wearer of a stream: recorded or synthetic trajectories, and the viewpoints computed from them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.soak.records import EyeMoment, StreamFrame
from benchmarks.soak.synthetic_tracker import tracker_samples
from wlr_render.errors import BadInputError
from wlr_render.mappings import EyeBox
from wlr_render.numerics.arrays import FloatArray
from wlr_render.tracking.eye_trajectory_file import read_eye_trajectory
from wlr_render.tracking.head_trajectory_file import read_head_trajectory
from wlr_render.tracking.synthetic import eye_motion, head_motion
from wlr_render.tracking.trajectory import EYES, EyeTrajectory, HeadTrajectory
from wlr_render.tracking.viewpoint_filter import ViewpointFilter
from wlr_render.warp.checks import nearest_in_reach

JITTER_M = 20e-6
"""Assumed standard deviation, per axis, of a synthetic tracker's samples. Real samples always differ, so that every
frame needs a new map; with a pupil exactly at rest, the map could be kept."""

_ROUNDING_S = 1e-9

Samples = Sequence[FloatArray | None]


@dataclass(frozen=True)
class Wearer:
    """Motion of head and eyes.

    Attributes:
        head: trajectory file (TUM or EuRoC); None for a synthetic head.
        eyes: eye trajectory file; None for synthetic eyes that jump, with a tracker that jitters, blinks and drops out.
        seed: seed of the synthetic motions.
    """

    head: Path | None = None
    eyes: Path | None = None
    seed: int = 1

    def moments(
        self, boxes: Mapping[str, EyeBox], count: int, frames_per_second: float, late_s: float = 0.0
    ) -> list[StreamFrame]:
        """Return the trackers' state for each frame, starting when all trajectories have started.

        Args:
            boxes: eye boxes by eye.
            count: number of frames, 2 or more.
            frames_per_second: frame rate, positive.
            late_s: time from the beginning of a frame to its scan-out.

        Raises:
            BadInputError: faulty files, an eye that a file does not have, or trajectories that are too short.
        """
        length_s = (count - 1) / frames_per_second + late_s
        head = read_head_trajectory(self.head) if self.head else head_motion(self.seed, length_s + 1.0)
        eyes = self._eyes(boxes, length_s + 1.0)
        start, end = self._overlap(head, eyes, boxes)
        time_s = start + np.arange(count) / frames_per_second
        if time_s[-1] + late_s > end + _ROUNDING_S:
            fitting = int((end - start - late_s) * frames_per_second + 1.0 + _ROUNDING_S)
            raise BadInputError(
                f"{self._files()}: together they cover {end - start:.3f} s, which is {max(fitting, 0)} frames at "
                f"{frames_per_second:g} per second, and {count} were asked for; ask for fewer, or record longer."
            )
        time_s = np.minimum(time_s, end - late_s)
        followed = {eye: _followed(self._samples(eyes, eye, time_s), time_s, box) for eye, box in boxes.items()}
        begun, lit = (_newest_pose(head, at_s) for at_s in (time_s, np.minimum(time_s + late_s, end)))
        lost = head.gaps_at(time_s).length_s > 0
        return [
            StreamFrame(float(t), begun[k], lit[k], {eye: track[k] for eye, track in followed.items()}, bool(lost[k]))
            for k, t in enumerate(time_s)
        ]

    def _eyes(self, boxes: Mapping[str, EyeBox], length_s: float) -> EyeTrajectory:
        if self.eyes is None:
            return eye_motion({eye: box.centre for eye, box in boxes.items()}, self.seed, length_s)
        eyes = read_eye_trajectory(self.eyes)
        missing = [eye for eye in boxes if eye not in eyes.tracks]
        if missing:
            there = " and ".join(eyes.tracks)
            raise BadInputError(f"{self.eyes}: has no {missing[0]} eye, only the {there} one; draw that.")
        return eyes

    def _samples(self, eyes: EyeTrajectory, eye: str, time_s: FloatArray) -> Samples:
        if self.eyes is None:
            rng = np.random.default_rng([self.seed, 3, EYES.index(eye)])
            noise = JITTER_M * rng.normal(size=(len(time_s), 3))
            samples = tracker_samples(eyes, time_s, self.seed)[eye]
            return [None if point is None else point + noise[k] for k, point in enumerate(samples)]
        seen = eyes.gaps_at(eye, time_s).length_s == 0
        return [point if good else None for point, good in zip(eyes.viewpoint_at(eye, time_s), seen, strict=True)]

    def _overlap(self, head: HeadTrajectory, eyes: EyeTrajectory, boxes: Mapping[str, EyeBox]) -> tuple[float, float]:
        tracks = [head.time_s, *(eyes.tracks[eye].time_s for eye in boxes)]
        start, end = max(float(track[0]) for track in tracks), min(float(track[-1]) for track in tracks)
        if end < start:
            raise BadInputError(f"{self._files()}: the tracks do not overlap in time; record them together.")
        return start, end

    def _files(self) -> str:
        """Describe the sources of motion; synthetic tracks begin at 0 s and last as long as requested."""
        return " and ".join(str(path) for path in (self.head, self.eyes) if path)


def _newest_pose(head: HeadTrajectory, time_s: FloatArray) -> FloatArray:
    """Return poses (n, 4, 4), interpolated between samples; in a gap, the last sample: later ones are not known yet."""
    return head.at(head.gaps_at(time_s).start_s)


def _followed(samples: Samples, time_s: FloatArray, box: EyeBox) -> list[EyeMoment]:
    """Return one eye's viewpoints after the filter, clamped to the range of its model."""
    follow, last, moments = ViewpointFilter(box.centre), None, []
    for moment_s, sample in zip(time_s, samples, strict=True):
        tracked = follow.update(float(moment_s), sample)
        at = nearest_in_reach(tracked.viewpoint, box)
        moved_mm = 0.0 if last is None else 1e3 * float(np.linalg.norm(at - last))
        moments.append(EyeMoment(at, tracked.state, moved_mm, bool((at != tracked.viewpoint).any())))
        last = at
    return moments
