"""Handles of frames that an engine draws, the prediction of their poses, and poses of a display's rows."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from wlr_render.compositing.checks import checked_number, nearest_in_reach
from wlr_render.compositing.eye_camera import EyeCamera
from wlr_render.errors import BadInputError
from wlr_render.geometry import transforms
from wlr_render.geometry.prediction import LONGEST_S, predicted_point, predicted_pose
from wlr_render.mappings import EyeBox
from wlr_render.numerics.arrays import FloatArray

HISTORY = 3
"""Frames that may be drawn at the same time: pictures of older ones are refused."""
Scan = Literal["down", "up"]
"""Order in which the rows of a display light up: the top one first, or the bottom one."""


@dataclass(frozen=True, eq=False)
class FrameHandle(Mapping[str, EyeCamera]):
    """A frame from `Compositor.begin_frame`: the camera to draw with, by eye.

    Attributes:
        number: of the frame, from 1.
        world_from_device: (4, 4) head pose that it is drawn for.
        viewpoints: (3,) by eye, device frame, metres.
        cameras: by eye.
        submitted: the eyes whose pictures have been submitted.
    """

    number: int
    world_from_device: FloatArray
    viewpoints: Mapping[str, FloatArray]
    cameras: Mapping[str, EyeCamera]
    submitted: set[str] = field(default_factory=set)

    def __getitem__(self, eye: str) -> EyeCamera:
        return self.cameras[eye]

    def __iter__(self) -> Iterator[str]:
        return iter(self.cameras)

    def __len__(self) -> int:
        return len(self.cameras)


@dataclass(frozen=True, eq=False)
class _Sample:
    time_s: float
    world_from_device: FloatArray
    viewpoints: Mapping[str, FloatArray]


class MotionPredictor:
    """Predicts head pose and pupils from the last two samples that came with a time, at constant velocity."""

    def __init__(self, boxes: Mapping[str, EyeBox]) -> None:
        """Prepare; `boxes` are the eye boxes, half a box outside of which predicted pupils are held."""
        self._boxes = boxes
        self._before: _Sample | None = None
        self._last: _Sample | None = None

    def predict(
        self,
        world_from_device: FloatArray,
        viewpoints: Mapping[str, FloatArray],
        time_s: float | None,
        predict_s: float,
    ) -> tuple[FloatArray, dict[str, FloatArray]]:
        """Pose (4, 4) and viewpoints (3,) by eye, `predict_s` after `time_s`.

        Unchanged if `predict_s` is 0, or if the last sample is more than 100 ms old or there is none.

        Raises:
            BadInputError: `predict_s` is not from 0 to 100 ms or has no `time_s`, or the time is not later than the
                last one; no sample is kept then.
        """
        ahead_s = checked_number(predict_s, "predict_s", 0, LONGEST_S)
        if time_s is None:
            if ahead_s:
                raise BadInputError("predict_s needs time_s, the time of the pose in seconds; give both.")
            return world_from_device, dict(viewpoints)
        now = checked_number(time_s, "time_s", -1e12, 1e12)
        if self._last is not None and now < self._last.time_s:
            raise BadInputError(
                f"time_s is {now:g} s, and that of the pose before was {self._last.time_s:g} s; give rising times."
            )
        if self._last is not None and now > self._last.time_s:
            self._before = self._last
        self._last, before = _Sample(now, world_from_device, dict(viewpoints)), self._before
        if before is None or not ahead_s or now - before.time_s > LONGEST_S:
            return world_from_device, dict(viewpoints)
        between_s = now - before.time_s
        pupils = {
            eye: nearest_in_reach(predicted_point(before.viewpoints[eye], at, between_s, ahead_s), self._boxes[eye])
            if eye in before.viewpoints
            else at
            for eye, at in viewpoints.items()
        }
        return predicted_pose(before.world_from_device, world_from_device, between_s, ahead_s), pupils


def row_poses(first: FloatArray, last: FloatArray, rows: int, scan: Scan = "down") -> FloatArray:
    """Interpolate the head pose of each row, (rows, 4, 4) from the top, between two (4, 4).

    `first` is the pose when the first row lights up, the bottom one with "up". Rows light up at equal intervals, and
    the head moves at constant speed meanwhile.
    """
    poses = transforms.between(first, last, np.linspace(0.0, 1.0, rows))
    return poses if scan == "down" else poses[::-1]
