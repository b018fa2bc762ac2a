"""Observe a wearer's head in motion: where the real dots and the virtual dots that are to cover them are seen.

Every frame is drawn without error for the head pose and the tracked pupil of its time. Effects decide when it is seen,
and from where; until then the head moves on evenly.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from oracle import sights
from oracle.captures import CAMERA_CENTRE_PX, CAMERA_FOCAL_PX, CAMERA_SIZE_PX
from oracle.devices import own_device
from oracle.effects import Effect
from oracle.nature import PERFECT, BenchNature
from oracle.own_tracer import FloatArray, turn, unit
from oracle.world import World

_REACH_MM = np.array([400.0, 200.0, 300.0])  # half the room in which the head is
_SWING_RAD, _SWING_MM = 0.4, 150.0  # how far the head swings about its middle pose
_FASTEST_RAD_S, _FASTEST_MM_S = 1.2, 400.0
_EYE_MM = np.array([2.5, 2.0, 2.0])  # half the box of tracked pupils
_GAZE_RAD = np.radians(20.0)
_FIELD = 0.35  # largest tangent at which dots are put; many lie beyond a small panel's edge
_NEAREST_MM, _FARTHEST_MM = 400.0, 3000.0
_EVERY_S = 0.1


@dataclass(frozen=True)
class RunTimePlan:
    """How large a run-time session is.

    Attributes:
        device: name of the headset.
        recordings: each with a head motion of its own, from slow to fast.
        moments: in each recording.
        sigma_px: noise of a point per axis, camera pixels; stated in the bench file, and true.
    """

    device: str = "northstar"
    recordings: int = 12
    moments: int = 60
    sigma_px: float = 0.3


@dataclass(frozen=True, eq=False)
class Motion:
    """What is known of each moment; millimetres, seconds, radians.

    Attributes:
        recording: (n,) which.
        time_s: (n,) since the session began.
        axes, place: (n, 3, 3), (n, 3) head pose, world from device.
        velocity, rate: (n, 3) of the head, world frame.
        viewpoint: (n, 3) tracked pupil, device frame.
        gaze: (n, 3) unit directions, device frame.
        dot: (n, 3) the real dot, world frame.
    """

    recording: NDArray[np.int64]
    time_s: FloatArray
    axes: FloatArray
    place: FloatArray
    velocity: FloatArray
    rate: FloatArray
    viewpoint: FloatArray
    gaze: FloatArray
    dot: FloatArray

    def dot_in_device(self, late_s: FloatArray) -> FloatArray:
        """The dots (n, 3) as the head has it so many seconds (n,) later."""
        axes = turn(self.rate * late_s[:, None]) @ self.axes
        return np.asarray(np.einsum("nji,nj->ni", axes, self.dot - self.place - self.velocity * late_s[:, None]))


@dataclass(frozen=True, eq=False)
class RunTimeSession:
    """A motion, and where the dots are seen, (n, 2) camera pixels each; NaN where the panel does not reach."""

    plan: RunTimePlan
    motion: Motion
    virtual: FloatArray
    real: FloatArray


def observe_run_time(
    plan: RunTimePlan, effects: Sequence[Effect], rng: np.random.Generator, nature: BenchNature = PERFECT
) -> RunTimeSession:
    """Observe glasses that are as stated but for the effects, applied in order, and for the size of the noise.

    Recordings stand for captures. The camera goes with the glasses, and points of one recording are not neighbours:
    motions and the shared noise of the nature do not count.

    Raises:
        BadInputError: the plan names a device that does not exist.
    """
    world = World(own_device(plan.device))
    motion = _motion(plan, world.device.eye, rng)
    for effect in effects:
        world = effect.applied(world)
    white = rng.normal(size=(2, len(motion.time_s), 2))
    virtual, real = (_camera_pixel(seen) for seen in _seen(world, motion))
    nature, own = replace(nature, shared=0.0), rng.spawn(1)[0]
    place, recording = np.concatenate([virtual, real]), np.tile(motion.recording, 2)
    noise = plan.sigma_px * nature.noise(white.reshape(-1, 2), place, recording, recording, np.inf, own)
    noise = noise.reshape(white.shape)
    return RunTimeSession(plan, motion, virtual + noise[0], real + noise[1])


def _seen(world: World, motion: Motion) -> tuple[FloatArray, FloatArray]:
    """Directions (n, 3) of the virtual and the real dots; NaN for dots beyond the panel's edge."""
    panel = world.device.panel
    wanted = sights.of_point(world, motion.viewpoint, motion.dot_in_device(np.zeros(len(motion.time_s))))
    pixel = sights.pixel_seen(world, motion.viewpoint, wanted)
    shown = np.all((pixel > 0.0) & (pixel < panel.pixels), axis=-1)
    pupil, late_s = motion.viewpoint, np.zeros(len(pixel))
    for move in world.pupil:
        pupil = move(pupil, motion.gaze)
    for delay in world.late:
        late_s = late_s + delay(pixel / panel.pixels)
    virtual = sights.of_pixel(world, pupil, np.where(shown[:, None], pixel, np.nan), wanted)
    gravity = motion.axes[:, 1, :]
    for flex in world.flex:
        virtual = np.einsum("nij,nj->ni", flex(gravity, motion.time_s), virtual)
    real = sights.of_point(world, pupil, motion.dot_in_device(late_s))
    if world.shutter:
        place = _camera_pixel(real) / CAMERA_SIZE_PX
        late_s = late_s + sum(delay(place) for delay in world.shutter)
        real = sights.of_point(world, pupil, motion.dot_in_device(late_s))
    return virtual, real


def _camera_pixel(direction: FloatArray) -> FloatArray:
    return np.asarray(CAMERA_CENTRE_PX + CAMERA_FOCAL_PX * direction[:, :2] / direction[:, 2:])


def _motion(plan: RunTimePlan, eye: FloatArray, rng: np.random.Generator) -> Motion:
    """Swings about a middle pose, each recording faster than the one before; dots all over the field."""
    recordings, count = plan.recordings, plan.recordings * plan.moments
    recording = np.repeat(np.arange(recordings), plan.moments)
    time_s = np.asarray(_EVERY_S * np.arange(count), dtype=np.float64)
    speed = ((np.arange(recordings) + 0.5) / recordings)[recording]
    turn_axis, move_axis = (unit(rng.normal(size=(recordings, 3)))[recording] for _ in range(2))
    middle = (_REACH_MM * rng.uniform(-1.0, 1.0, (recordings, 3)))[recording]
    facing = turn(np.outer(rng.uniform(-np.pi, np.pi, recordings), [0.0, 1.0, 0.0]))[recording]
    turn_phase, move_phase = (2.0 * np.pi * rng.uniform(size=count) for _ in range(2))
    axes = turn(turn_axis * (_SWING_RAD * np.sin(turn_phase))[:, None]) @ facing
    place = middle + move_axis * (_SWING_MM * np.sin(move_phase))[:, None]
    device_dot = eye + sights.forward(rng.uniform(-_FIELD, _FIELD, (count, 2))) * _distance(rng, count)
    return Motion(
        recording=recording,
        time_s=time_s,
        axes=axes,
        place=place,
        velocity=move_axis * (_FASTEST_MM_S * speed * np.cos(move_phase))[:, None],
        rate=turn_axis * (_FASTEST_RAD_S * speed * np.cos(turn_phase))[:, None],
        viewpoint=eye + _EYE_MM * rng.uniform(-1.0, 1.0, (count, 3)),
        gaze=sights.forward(np.tan(rng.uniform(-_GAZE_RAD, _GAZE_RAD, (count, 2)))),
        dot=np.einsum("nij,nj->ni", axes, device_dot) + place,
    )


def _distance(rng: np.random.Generator, count: int) -> FloatArray:
    """Distances (n, 1) of dots, even in their inverse."""
    return 1.0 / rng.uniform(1.0 / _FARTHEST_MM, 1.0 / _NEAREST_MM, (count, 1))
