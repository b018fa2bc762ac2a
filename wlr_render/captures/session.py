"""One measuring session: the setup and, row by row, the readings. Device frame (OpenXR), metres, seconds.

A row of a *plan* has the nominal state of the bench for one reading; the *session* adds the reading. A simulation
predicts the readings of a plan, so that measured minus simulated is one subtraction.
"""

from dataclasses import dataclass, field, fields, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from wlr_render.html_summary import SummaryTable, html_summary
from wlr_render.numerics.arrays import FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class _Plan:
    """Setup of a part of a session.

    Attributes:
        capture: (n,) index of the photograph, or of the recording.
        time_s: (n,) time since the session's start; at run time, the intended display time of the frame.
    """

    capture: IntArray
    time_s: FloatArray

    def __len__(self) -> int:
        return len(self.capture)


@dataclass(frozen=True, eq=False)
class StagePlan(_Plan):
    """Setup of the readings of a camera on a stage; other attributes as in `_Plan`.

    Attributes:
        travel: (n,) direction of the stage's last move in x, +1 or -1.
        stage: (n, 3) position of the camera's centre of projection read from the micrometers.
        orientation: (n, 3, 3) device_from_camera if the camera was turned between captures; None if it always looks
            along -z.
        sigma_px: (n,) standard deviation of each reading per axis, camera pixels; None if the bench's `point_sigma_px`
            holds for all.
    """

    travel: FloatArray
    stage: FloatArray
    orientation: FloatArray | None = field(default=None, kw_only=True)
    sigma_px: FloatArray | None = field(default=None, kw_only=True)


@dataclass(frozen=True, eq=False)
class DisplayPlan(StagePlan):
    """Setup of the panel's readings: the panel position that a camera pixel shows.

    Attributes:
        channel: (n,) colour: 0 red, 1 green, 2 blue.
        camera_pixel: (n, 2) camera pixels.
    """

    channel: IntArray
    camera_pixel: FloatArray


@dataclass(frozen=True, eq=False)
class SeeThroughPlan(StagePlan):
    """Setup of a printed target's readings through the optics: the camera pixel of a dot.

    Attributes:
        target_pose: (n,) index of the target's pose; captures count from 0 for every pose of the target.
        dot: (n, 2) position of the dot on the printed target, metres.
        bare_pixel: (n, 2) pixels of the dots for the same camera at the same position without the headset; None if not
            photographed. A dot is assumed to lie on this pixel's ray, at the distance given by the tracked pose.
        height: (n,) height of the dot above the plane of the target, metres; None for a flat target.
    """

    target_pose: IntArray
    dot: FloatArray
    bare_pixel: FloatArray | None = None
    height: FloatArray | None = None


@dataclass(frozen=True, eq=False)
class RunTimePlan(_Plan):
    """Setup of run-time readings: the camera pixels of the real dot and of the virtual dot meant to cover it.

    Attributes:
        world_from_device: (n, 4, 4) head pose at the time.
        head_velocity: (n, 3) metres per second, world frame.
        head_rate: (n, 3) angular velocity, radians per second, world frame.
        viewpoint: (n, 3) tracked position of the pupil.
        gaze: (n, 3) unit gaze direction.
        dot: (n, 3) the real dot, world frame.
    """

    world_from_device: FloatArray
    head_velocity: FloatArray
    head_rate: FloatArray
    viewpoint: FloatArray
    gaze: FloatArray
    dot: FloatArray


AnyPlan = TypeVar("AnyPlan", DisplayPlan, SeeThroughPlan, RunTimePlan)


@dataclass(frozen=True, eq=False)
class SessionPlan:
    """Setup of all readings of a session; a missing part is None."""

    display: DisplayPlan | None = None
    see_through: SeeThroughPlan | None = None
    run_time: RunTimePlan | None = None

    @property
    def parts(self) -> tuple[DisplayPlan | None, SeeThroughPlan | None, RunTimePlan | None]:
        """The parts in order."""
        return self.display, self.see_through, self.run_time


@dataclass(frozen=True, eq=False)
class Readings:
    """Measured or predicted readings for each row of a plan; None for a missing part.

    Attributes:
        panel_pixel: (n, 2) panel position for each display row.
        dot_pixel: (m, 2) camera pixel for each see-through row.
        run_time_pixel: (k, 4) camera pixel of the virtual dot (2), then of the real dot (2), for each run-time row.
    """

    panel_pixel: FloatArray | None = None
    dot_pixel: FloatArray | None = None
    run_time_pixel: FloatArray | None = None

    @property
    def parts(self) -> tuple[FloatArray | None, FloatArray | None, FloatArray | None]:
        """The readings of each part, in order."""
        return self.panel_pixel, self.dot_pixel, self.run_time_pixel


@dataclass(frozen=True, eq=False)
class Session:
    """A plan and its readings.

    Attributes:
        name: source of the session, for messages and reports.
        plan: setup of the readings.
        readings: the readings.
    """

    name: str
    plan: SessionPlan
    readings: Readings

    def _repr_html_(self) -> str:
        rows = []
        for name, part in zip(("display", "see-through", "run-time"), self.plan.parts, strict=True):
            if part is not None:
                pose = part.target_pose if isinstance(part, SeeThroughPlan) else np.zeros_like(part.capture)
                captures = np.unique(np.stack([part.capture, pose]), axis=1).shape[1]
                poses = str(len(np.unique(pose))) if isinstance(part, SeeThroughPlan) else "-"
                rows.append([name, str(len(part)), str(captures), poses])
        table = SummaryTable(["part", "readings", "captures", "target poses"], rows)
        return html_summary(f"Bench session {self.name}", [], [table])


def select_rows(plan: AnyPlan, rows: NDArray[Any]) -> AnyPlan:
    """Return the rows of a plan, by index or mask."""
    kept: dict[str, Any] = {}
    for each in fields(plan):
        value = getattr(plan, each.name)
        kept[each.name] = None if value is None else value[rows]
    return replace(plan, **kept)
