"""The frames of `render`: when each is drawn, from which viewpoint and with which head pose."""

from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from wlr_render.errors import BadInputError
from wlr_render.io.input_files import shown
from wlr_render.jobs import limits
from wlr_render.jobs.headset import require_in_eye_box
from wlr_render.jobs.render_options import RenderOptions
from wlr_render.mappings import Eye
from wlr_render.numerics.arrays import FloatArray
from wlr_render.tracking.eye_trajectory_file import read_eye_trajectory
from wlr_render.tracking.head_trajectory_file import read_head_trajectory
from wlr_render.tracking.trajectory import EyeTrack, EyeTrajectory, HeadTrajectory

METADATA = "metadata.jsonl"
"""File with a row for each frame; Hugging Face's `datasets` expects this name."""
LONGEST_GAP_S = 1.0
"""Between neighbouring samples of a trajectory; a longer one is a dropout, or a file in milliseconds."""


@dataclass(frozen=True)
class Motion:
    """Motion of the wearer over the frames; head and eyes rest without a trajectory."""

    head: HeadTrajectory | None
    eyes: EyeTrajectory | None
    frames_per_second: float
    frame_limit: int | None = None

    def tracks(self, eyes: Collection[str]) -> list[tuple[str, HeadTrajectory | EyeTrack]]:
        """Return file name and track of the head, and of each eye that is drawn."""
        tracks = self.eyes.tracks.items() if self.eyes else ()
        drawn = [(self.eyes.name, track) for eye, track in tracks if self.eyes and eye in eyes]
        return [(self.head.name, self.head), *drawn] if self.head else [*drawn]


@dataclass(frozen=True, eq=False)
class PlannedFrame:
    """One frame to draw."""

    index: int
    time_s: float
    eye: str
    viewpoint: FloatArray
    world_from_device: FloatArray
    held: bool = False
    """Whether the pupil is held: in a gap of the eye track, or outside the eye box."""
    eye_gap_s: float = 0.0
    """Length of the gap in the eye track that contains this frame, seconds; 0 if none."""
    head_gap_s: float = 0.0
    """Length of the gap between samples of the head in which it lies; 0 in none."""
    head_inferred: bool = False
    """Whether the runtime inferred the head's pose while it did not track the head."""

    @property
    def stem(self) -> str:
        """File name of the frame without the suffix."""
        return f"{self.eye}-{self.index:06d}"

    def file(self, folder: Path, suffix: str = ".png") -> Path:
        """Return the path of one of the frame's files, by default of the panel image."""
        return folder / f"{self.stem}{suffix}"

    @property
    def facts(self) -> dict[str, Any]:
        """Eye, time stamp, viewpoint and head pose, as JSON values."""
        return {
            "eye": self.eye,
            "index": self.index,
            "time_s": self.time_s,
            "viewpoint_in_device_m": self.viewpoint.tolist(),
            "world_from_device": self.world_from_device.tolist(),
            "held": bool(self.held),
            "head_lost": bool(self.head_gap_s or self.head_inferred),
        }


def motion_of(options: RenderOptions) -> Motion:
    """Read the trajectories that the options name."""
    head = read_head_trajectory(options.head) if options.head else None
    eyes = read_eye_trajectory(options.eye_track) if options.eye_track else None
    return Motion(head, eyes, options.frames_per_second, options.frame_limit)


def planned_frames(motion: Motion, mappings: dict[str, Eye]) -> list[PlannedFrame]:
    """Return the time, viewpoint and head pose of each frame, in time order.

    Raises:
        BadInputError: trajectories that do not overlap in time, or an eye whose viewpoints are all outside the eye box.
    """
    times, head = _times(motion, mappings), motion.head
    pupils = {eye: _pupils(motion.eyes, mappings[eye], times) for eye in mappings}
    head_gap_s = head.gaps_at(times).length_s if head else np.zeros(len(times))
    inferred = head.is_inferred_at(times) if head else np.zeros(len(times), bool)
    plan = []
    for index, time_s in enumerate(times):
        pose = head.at(time_s) if head else np.eye(4)
        for eye in mappings:
            viewpoint, held, eye_gap_s = pupils[eye][index]
            losses = eye_gap_s, float(head_gap_s[index]), bool(inferred[index])
            plan.append(PlannedFrame(index, float(time_s), eye, viewpoint, pose, held, *losses))
    return plan


def _pupils(eyes: EyeTrajectory | None, mappings: Eye, times: FloatArray) -> list[tuple[FloatArray, bool, float]]:
    """Return the viewpoint (3,) of each frame, whether it is held, and the length of the gap in which it lies, or 0.

    In a gap between samples, such as a blink, a pupil is held at the last sample. Outside the eye box it is held at its
    last place inside or, before the first such place, at the nearest point of the eye box.
    """
    box = mappings.eye_box
    if eyes is None:
        return [(box.centre, False, 0.0)] * len(times)
    gaps = eyes.gaps_at(mappings.eye, times)
    tracked = [eyes.viewpoint_at(mappings.eye, time_s) for time_s in gaps.start_s]
    inside = [box.contains(place, margin=1e-6) for place in tracked]
    if not any(inside):
        require_in_eye_box(mappings, tracked[0], f"{eyes.name} at {times[0]:.4f} s, {mappings.eye} eye")
    pupils: list[tuple[FloatArray, bool, float]] = []
    last: FloatArray | None = None
    for place, is_inside, gap_s in zip(tracked, inside, gaps.length_s, strict=True):
        last = place if is_inside else last
        nearest = np.clip(place, box.centre - box.size / 2, box.centre + box.size / 2) if last is None else last
        pupils.append((nearest, not is_inside or gap_s > 0, float(gap_s)))
    return pupils


def _times(motion: Motion, eyes: Collection[str]) -> FloatArray:
    tracks = motion.tracks(eyes)
    spans = [(track.time_s[0], track.time_s[-1]) for _, track in tracks]
    if not spans:
        return np.zeros(1)
    start, end = max(first for first, _ in spans), min(last for _, last in spans)
    if end < start:
        files = " and ".join(dict.fromkeys(file for file, _ in tracks))
        raise BadInputError(f"The tracks of {files} do not overlap in time; record them together.")
    count = (end - start) * motion.frames_per_second + 1
    if min(count, motion.frame_limit or count) > limits.FRAMES:
        raise BadInputError(
            f"--fps {motion.frames_per_second:g} over {end - start:g} s are {count:.0f} frames; draw at most "
            f"{limits.FRAMES}: lower --fps, or give --frames."
        )
    times = start + np.arange(min(int(count + 1e-9), limits.FRAMES)) / motion.frames_per_second
    # Rounding must not carry the last frame beyond the tracks.
    return np.asarray(np.minimum(times, end)[: motion.frame_limit])


def gap_warnings(motion: Motion, eyes: Collection[str]) -> list[str]:
    """Return a sentence for each file with gaps above `LONGEST_GAP_S`, or without valid samples at either end."""
    gaps: dict[str, float] = {}
    cut: list[str] = []
    for file, track in motion.tracks(eyes):
        gaps[file] = max(gaps.get(file, 0.0), float(np.diff(track.time_s).max()))
        first, last = track.time_s[[0, -1]]
        outside = int(((track.invalid_s < first) | (track.invalid_s > last)).sum())
        if outside:
            cut.append(
                f"{file}: {outside} samples before {first:.4f} s or after {last:.4f} s are not valid; no frame lies "
                "there."
            )
    long = [
        f"{file}: neighbouring samples are up to {gap:.3g} s apart; are the times in seconds?"
        for file, gap in gaps.items()
        if gap > LONGEST_GAP_S
    ]
    return [*long, *dict.fromkeys(cut)]


def column_warnings(motion: Motion) -> list[str]:
    """Return a sentence for each file with columns that are not read."""
    return [
        f"{each.name}: not read: {', '.join(map(shown, each.unread))}; docs/files.md has the columns that are."
        for each in (motion.head, motion.eyes)
        if each is not None and each.unread
    ]


def held_warnings(motion: Motion, plan: list[PlannedFrame]) -> list[str]:
    """Return a sentence for each eye whose pupil was held in some frames, and one for gaps of the head."""
    warnings, track = [], motion.eyes and motion.eyes.name
    for eye in dict.fromkeys(planned.eye for planned in plan):
        own = [planned for planned in plan if planned.eye == eye]
        lost = [planned for planned in own if planned.eye_gap_s]
        outside = [planned for planned in own if planned.held and not planned.eye_gap_s]
        if lost:
            warnings.append(
                f"{track}: the {eye} pupil was not tracked or recorded in {_share(lost, own)}, in gaps of up to "
                f"{max(planned.eye_gap_s for planned in lost):.3g} s; there it is held at the last sample ('held' in "
                f"{METADATA})."
            )
        if outside:
            warnings.append(
                f"{track}: the {eye} pupil is outside the eye box in {_share(outside, own)}; there it is "
                f"held at its last place inside ('held' in {METADATA})."
            )
    frames = list({planned.index: planned for planned in plan}.values())
    lost = [planned for planned in frames if planned.head_gap_s]
    if lost:
        warnings.append(
            f"{motion.head and motion.head.name}: the head was not tracked or recorded in {_share(lost, frames)}, "
            f"in gaps of up to {max(planned.head_gap_s for planned in lost):.3g} s; there its pose is interpolated "
            f"('head_lost' in {METADATA})."
        )
    inferred = [planned for planned in frames if planned.head_inferred]
    if inferred:
        warnings.append(
            f"{motion.head and motion.head.name}: the runtime did not track the head in {_share(inferred, frames)}; "
            f"there its pose is the one that the runtime inferred ('head_lost' in {METADATA})."
        )
    return warnings


def _share(some: list[PlannedFrame], of: list[PlannedFrame]) -> str:
    return f"{len(some)} of {len(of)} frames, first at {some[0].time_s:.4f} s"
