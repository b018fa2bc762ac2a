"""Frames that an engine draws: handles, order and history, prediction of their poses, and poses of a display's rows."""

import bisect
import threading
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from wlr_render.errors import BadInputError
from wlr_render.geometry import transforms
from wlr_render.geometry.pose_prediction import LONGEST_S, predicted_point, predicted_pose
from wlr_render.mappings import EyeBox
from wlr_render.numerics.arrays import FloatArray
from wlr_render.warp.checks import checked_number, nearest_in_reach
from wlr_render.warp.eye_camera import EyeCamera

HISTORY = 3
"""Number of frames that may be drawn at the same time: pictures of older frames are refused."""
Scan = Literal["down", "up"]
"""Order in which the rows of a display light up: top row first, or bottom row first."""


@dataclass(frozen=True, eq=False)
class FrameHandle(Mapping[str, EyeCamera]):
    """A frame from `Compositor.begin_frame`: the camera to draw with, by eye.

    Attributes:
        number: number of the frame, from 1.
        cameras: cameras by eye.
        submitted: eyes with a submitted picture.
    """

    number: int
    cameras: Mapping[str, EyeCamera]
    submitted: set[str] = field(default_factory=set)

    # Mapping compares by content; a frame compares by identity, and may be a key of a dictionary.
    __eq__ = object.__eq__
    __hash__ = object.__hash__

    @property
    def world_from_device(self) -> FloatArray:
        """(4, 4) head pose for which it was begun."""
        return next(iter(self.cameras.values())).view.world_from_device

    @property
    def viewpoints(self) -> dict[str, FloatArray]:
        """(3,) by eye, device frame, metres."""
        return {eye: camera.viewpoint for eye, camera in self.cameras.items()}

    def __getitem__(self, eye: str) -> EyeCamera:
        return self.cameras[eye]

    def __iter__(self) -> Iterator[str]:
        return iter(self.cameras)

    def __len__(self) -> int:
        return len(self.cameras)


class FrameHistory:
    """The last frames of a compositor, and the newest picture of each eye.

    Attributes:
        shown: by eye, the frame of its newest picture.
        drawn: by eye, the camera that drew it.
        viewpoints: by eye, its newest viewpoint (3,), device frame.
    """

    def __init__(self) -> None:
        self.shown: dict[str, FrameHandle] = {}
        self.drawn: dict[str, EyeCamera] = {}
        self.viewpoints: dict[str, FloatArray] = {}
        self._frames: list[FrameHandle] = []  # newest last
        self._not_copied: dict[str, Any] = {}
        self._count = 0

    def begin(self, cameras: Mapping[str, EyeCamera]) -> FrameHandle:
        """Return the handle of a new frame; see `FrameHandle`."""
        self._count += 1
        handle = FrameHandle(self._count, cameras)
        self._frames = [*self._frames, handle][-HISTORY:]
        self.viewpoints |= handle.viewpoints
        return handle

    def frame(self, frame: FrameHandle | None) -> FrameHandle:
        """Return a frame that may be submitted; the newest if None.

        Raises:
            BadInputError: no frame was begun, or this one is not among the last `HISTORY`.
        """
        if frame is None:
            if not self._frames:
                raise BadInputError("there is no frame; call begin_frame first.")
            return self._frames[-1]
        if not any(frame is each for each in self._frames):
            raise BadInputError(
                f"frame is not one of the last {HISTORY} of this compositor; drop its picture, and give what "
                "begin_frame returned."
            )
        return frame

    def check_order(self, handle: FrameHandle, eye: str, not_copied: Any) -> None:
        """Check that an eye's picture may be submitted now.

        Args:
            handle: frame of the picture.
            eye: "left" or "right".
            not_copied: texture of a picture that is not copied; None for others.

        Raises:
            BadInputError: the eye has a picture of this frame or of a newer one, or the texture holds the other eye's.
        """
        if eye in handle.submitted:
            raise BadInputError(f"the {eye} eye was submitted already in this frame; call begin_frame for the next.")
        last = self.shown.get(eye)
        if last is not None and last.number > handle.number:
            raise BadInputError(
                f"frame {handle.number} is older than frame {last.number}, which the {eye} eye shows already; "
                "drop its picture."
            )
        others = (texture for name, texture in self._not_copied.items() if name != eye)
        if not_copied is not None and any(not_copied is texture for texture in others):
            raise BadInputError(
                f"the {eye} eye's picture has overwritten the other eye's; draw each under a name of its own, as in "
                "draw_on_gpu(view, eye)."
            )

    def check_inset(self, handle: FrameHandle, inset: EyeCamera) -> None:
        """Check that an inset belongs to the picture of a frame that its eye shows.

        Raises:
            BadInputError: the eye shows another frame, or its picture was drawn from another pose.
        """
        eye = inset.eye
        if self.shown.get(eye) is not handle:
            raise BadInputError(f"the {eye} eye does not show this frame; submit its picture before its insets.")
        if not np.array_equal(inset.world_from_camera, self.drawn[eye].world_from_camera):
            raise BadInputError(
                f"the inset's camera is not of the {eye} eye in this frame; make it with `inset` of the camera that "
                "drew the eye's picture."
            )

    def submitted(self, handle: FrameHandle, camera: EyeCamera, not_copied: Any) -> None:
        """Record that an eye shows the picture of a frame, drawn with a camera; for the arguments see `check_order`."""
        handle.submitted.add(camera.eye)
        self.shown[camera.eye], self.drawn[camera.eye] = handle, camera
        self._not_copied[camera.eye] = not_copied


class _Samples:
    """The newest samples of one quantity, an array of fixed shape, in the order of their times."""

    def __init__(self) -> None:
        self._times_s: list[float] = []
        self._values: list[FloatArray] = []

    def add(self, time_s: float, value: FloatArray) -> tuple[float, FloatArray] | None:
        """Keep a sample, and return the newest kept sample that is older, with its time; None without one."""
        at = bisect.bisect_left(self._times_s, time_s)
        replaced = at < len(self._times_s) and self._times_s[at] == time_s
        self._times_s[at : at + replaced], self._values[at : at + replaced] = [time_s], [value]
        before = (self._times_s[at - 1], self._values[at - 1]) if at else None
        # A call may be LONGEST_S late, and is then predicted from a sample up to LONGEST_S older.
        old = bisect.bisect_left(self._times_s, self._times_s[-1] - 2 * LONGEST_S)
        del self._times_s[:old], self._values[:old]
        return before


class MotionPredictor:
    """Predicts head pose and pupils from two samples with time stamps, at constant velocity.

    Head and pupils have separate samples: a call without a pupil leaves the pupil's prediction unchanged. An engine may
    begin a frame with a pose that is older than the pose that the last frame was composed for.
    """

    def __init__(self, boxes: Mapping[str, EyeBox]) -> None:
        """Prepare; predicted pupils are clamped to half a box outside the eye boxes `boxes`."""
        self._boxes = boxes
        self._head = _Samples()
        self._pupils = {eye: _Samples() for eye in boxes}
        self._newest_s = -np.inf
        self._in_use = threading.Lock()

    def predict(
        self,
        world_from_device: FloatArray,
        viewpoints: Mapping[str, FloatArray],
        time_s: float | None,
        predict_s: float,
    ) -> tuple[FloatArray, dict[str, FloatArray]]:
        """Return the pose (4, 4) and viewpoints (3,) by eye, `predict_s` after `time_s`.

        Each is unchanged if `predict_s` is 0, or if its sample before `time_s` is more than 100 ms older or missing.

        Raises:
            BadInputError: `predict_s` is not from 0 to 100 ms or has no `time_s`, or the time is more than 100 ms
                before the latest; no sample is kept then.
        """
        ahead_s = checked_number(predict_s, "predict_s", 0, LONGEST_S)
        if time_s is None:
            if ahead_s:
                raise BadInputError("predict_s needs time_s, the time of the pose in seconds; give both.")
            return world_from_device, dict(viewpoints)
        now = checked_number(time_s, "time_s", -1e12, 1e12)
        with self._in_use:  # one thread may begin a frame while another composes
            return self._moved(world_from_device, viewpoints, now, ahead_s)

    def _moved(
        self, world_from_device: FloatArray, viewpoints: Mapping[str, FloatArray], now: float, ahead_s: float
    ) -> tuple[FloatArray, dict[str, FloatArray]]:
        if now < self._newest_s - LONGEST_S:
            raise BadInputError(
                f"time_s is {now:g} s, and that of the pose before was {self._newest_s:g} s; take all times from one "
                f"clock, and drop poses that come more than {LONGEST_S * 1e3:g} ms late."
            )
        self._newest_s = max(now, self._newest_s)
        before = self._head.add(now, world_from_device)
        pose = world_from_device
        if before and _is_usable(now - before[0], ahead_s):
            pose = predicted_pose(before[1], pose, now - before[0], ahead_s)
        pupils = {eye: self._predicted_pupil(eye, at, now, ahead_s) for eye, at in viewpoints.items()}
        return pose, pupils

    def _predicted_pupil(self, eye: str, at: FloatArray, now_s: float, ahead_s: float) -> FloatArray:
        before = self._pupils[eye].add(now_s, at)
        if before is None or not _is_usable(now_s - before[0], ahead_s):
            return at
        return nearest_in_reach(predicted_point(before[1], at, now_s - before[0], ahead_s), self._boxes[eye])


def _is_usable(between_s: float, ahead_s: float) -> bool:
    return bool(ahead_s) and between_s <= LONGEST_S


def row_poses(first: FloatArray, last: FloatArray, height_px: int, grid_rows: int, scan: Scan = "down") -> FloatArray:
    """Return head poses at the rows of a warp grid, (grid_rows, 4, 4) from the display's top edge to its bottom edge.

    `first` and `last` (4, 4) are the poses when the first and the last pixel row light up; with "up" the bottom row is
    first. The rows light up at equal intervals, and the head moves at constant speed meanwhile, also over the half
    pixels between the centres of the outermost rows and the edges.
    """
    pixel_row = np.linspace(0, height_px, grid_rows) - 0.5
    poses = transforms.between(first, last, pixel_row / max(height_px - 1, 1))
    return poses if scan == "down" else poses[::-1]
