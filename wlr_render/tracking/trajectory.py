"""Sampled head and eye trajectories, interpolated between the first and the last sample.

Trajectories interpolate over gaps, too; `gaps_at` returns the gaps.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Protocol

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from wlr_render.errors import BadInputError
from wlr_render.geometry import directions, transforms
from wlr_render.numerics.arrays import FloatArray
from wlr_render.tracking.eye_model import RotatingEye
from wlr_render.tracking.samples import Gaps, bracket, gaps_at, require_ascending

EYES = ("left", "right")


class _Sampled:
    """Samples at ascending times, and times at which the recording has no valid sample."""

    time_s: FloatArray
    invalid_s: FloatArray

    def gaps_at(self, time_s: ArrayLike) -> Gaps:
        """Return the gaps between the samples at times (...)."""
        return gaps_at(self.time_s, time_s, self.invalid_s)


def _none() -> FloatArray:
    return np.zeros(0)


@dataclass(frozen=True, eq=False)
class HeadTrajectory(_Sampled):
    """Head trajectory: poses of the headset in the world.

    Attributes:
        time_s: (n,) ascending, n >= 2.
        position_in_world: (n, 3) origin of the device frame, metres.
        world_from_device_xyzw: (n, 4) unit quaternions.
        name: name for messages, e.g. the file.
        invalid_s: (m,) times at which the recording has no valid sample.
        unread: columns of the file that are not read.
        inferred_s: (k,) times of samples that the runtime inferred while it did not track the head.
    """

    time_s: FloatArray
    position_in_world: FloatArray
    world_from_device_xyzw: FloatArray
    name: str = "head trajectory"
    invalid_s: FloatArray = field(default_factory=_none)
    unread: tuple[str, ...] = ()
    inferred_s: FloatArray = field(default_factory=_none)

    def __post_init__(self) -> None:
        require_ascending(self.time_s, self.name)

    def is_inferred_at(self, time_s: ArrayLike) -> NDArray[np.bool_]:
        """Return whether an inferred sample has more than 0.1 % of the weight in the poses at times (...)."""
        between, inferred = bracket(self.time_s, time_s, self.name), np.isin(self.time_s, self.inferred_s)
        before, after = inferred[between.before], inferred[between.before + 1]
        return np.asarray((before & (between.fraction < 0.999)) | (after & (between.fraction > 0.001)))

    def at(self, time_s: ArrayLike) -> FloatArray:
        """Return the poses `world_from_device` (..., 4, 4) at times (...): linear in position, slerp in rotation.

        Raises:
            BadInputError: a time outside the trajectory.
        """
        position = bracket(self.time_s, time_s, self.name).linear(self.position_in_world)
        rotation = self._rotation(np.ravel(np.asarray(time_s, dtype=np.float64))).as_matrix()
        return transforms.rigid(rotation.reshape(*position.shape, 3), position)

    @cached_property
    def _rotation(self) -> "scipy.spatial.transform.Slerp":
        return scipy.spatial.transform.Slerp(
            self.time_s, scipy.spatial.transform.Rotation.from_quat(self.world_from_device_xyzw)
        )


class EyeTrack(Protocol):
    """Trajectory of one eye."""

    @property
    def time_s(self) -> FloatArray:
        """(n,) ascending sample times."""

    @property
    def invalid_s(self) -> FloatArray:
        """(m,) times at which the recording has no valid sample."""

    def gaps_at(self, time_s: ArrayLike) -> Gaps:
        """Return the gaps between the samples at times (...)."""

    def viewpoint_at(self, time_s: ArrayLike) -> FloatArray:
        """Return the entrance pupils (..., 3) at times (...), device frame, metres."""


@dataclass(frozen=True, eq=False)
class ViewpointTrack(_Sampled):
    """Trajectory of one eye from tracked entrance pupils.

    Attributes:
        time_s: (n,) ascending, n >= 2.
        viewpoint_in_device: (n, 3) metres.
        name: name for messages.
        invalid_s: (m,) times at which the recording has no valid sample.
    """

    time_s: FloatArray
    viewpoint_in_device: FloatArray
    name: str = "eye trajectory"
    invalid_s: FloatArray = field(default_factory=_none)

    def __post_init__(self) -> None:
        require_ascending(self.time_s, self.name)

    def viewpoint_at(self, time_s: ArrayLike) -> FloatArray:
        """Return the entrance pupils (..., 3) at times (...), device frame, linear between samples."""
        return bracket(self.time_s, time_s, self.name).linear(self.viewpoint_in_device)


@dataclass(frozen=True, eq=False)
class GazeTrack(_Sampled):
    """Trajectory of one eye from tracked gaze; the eye model gives the entrance pupil.

    Attributes:
        time_s: (n,) ascending, n >= 2.
        gaze_dir: (n, 3) unit, device frame.
        eye_model: rotation centre and pupil distance.
        name: name for messages.
        invalid_s: (m,) times at which the recording has no valid sample.
    """

    time_s: FloatArray
    gaze_dir: FloatArray
    eye_model: RotatingEye
    name: str = "eye trajectory"
    invalid_s: FloatArray = field(default_factory=_none)

    def __post_init__(self) -> None:
        require_ascending(self.time_s, self.name)

    def gaze_at(self, time_s: ArrayLike) -> FloatArray:
        """Return the unit gaze directions (..., 3) at times (...), rotating at a constant rate between samples."""
        between = bracket(self.time_s, time_s, self.name)
        return _slerp_directions(*between.pair(self.gaze_dir), between.fraction)

    def viewpoint_at(self, time_s: ArrayLike) -> FloatArray:
        """Return the entrance pupils (..., 3) at times (...), device frame."""
        return self.eye_model.viewpoint_of_gaze(self.gaze_at(time_s))


def _slerp_directions(first: FloatArray, second: FloatArray, fraction: FloatArray) -> FloatArray:
    """Return the spherical interpolation between unit directions (..., 3) that are not opposite."""
    angle = directions.angle_between(first, second)
    sine = np.sin(angle)
    small = sine < 1e-9
    safe = np.where(small, 1.0, sine)
    a = np.where(small, 1.0 - fraction, np.sin((1.0 - fraction) * angle) / safe)
    b = np.where(small, fraction, np.sin(fraction * angle) / safe)
    return directions.normalised(a[..., None] * first + b[..., None] * second)


@dataclass(frozen=True, eq=False)
class EyeTrajectory:
    """Trajectories of one or both eyes.

    Attributes:
        tracks: track of each eye, by "left" or "right".
        name: name for messages, e.g. the file.
        unread: columns of the file that are not read.
    """

    tracks: Mapping[str, EyeTrack]
    name: str = "eye trajectory"
    unread: tuple[str, ...] = ()

    def viewpoint_at(self, eye: str, time_s: ArrayLike) -> FloatArray:
        """Return the entrance pupils (..., 3) of one eye at times (...), device frame, metres.

        Raises:
            BadInputError: an eye that was not tracked, or a time outside its track.
        """
        return self._track(eye).viewpoint_at(time_s)

    def gaps_at(self, eye: str, time_s: ArrayLike) -> Gaps:
        """Return the gaps between the samples of one eye at times (...).

        Raises:
            BadInputError: an eye that was not tracked.
        """
        return self._track(eye).gaps_at(time_s)

    def _track(self, eye: str) -> EyeTrack:
        if eye not in self.tracks:
            raise BadInputError(f"{self.name}: there is no eye '{eye}' in it, only {', '.join(sorted(self.tracks))}.")
        return self.tracks[eye]
