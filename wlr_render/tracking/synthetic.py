"""Synthetic wearer: smooth head motion and saccades, reproducible by seed. For demonstrations, not as evidence."""

import numpy as np
import scipy
from numpy.random import Generator

from wlr_render.geometry import directions
from wlr_render.numerics.arrays import FloatArray
from wlr_render.tracking.eye_model import RotatingEye
from wlr_render.tracking.minimum_jerk import minimum_jerk
from wlr_render.tracking.trajectory import EyeTrajectory, GazeTrack, HeadTrajectory

_SWAY_M = np.array([0.05, 0.02, 0.04])
_TURN_DEG = np.array([4.0, 9.0, 2.0])  # rotations about x (nod), y (shake), z (tilt)
_FREQUENCY_HZ = np.array([0.13, 0.31, 0.52])
_FIXATION_S = (0.2, 0.6)
_GAZE_SPREAD_DEG = np.array([9.0, 6.0])


def head_motion(seed: int, duration_s: float = 10.0, rate_hz: float = 90.0) -> HeadTrajectory:
    """Return a smooth head motion around the world's origin: a few centimetres and degrees, at most about 40 deg/s.

    Args:
        seed: seed of the random phases.
        duration_s: duration from time 0.
        rate_hz: samples per second.
    """
    rng = np.random.default_rng(seed)
    time_s = _sample_times(duration_s, rate_hz)
    waves = _slow_waves(rng, time_s)
    position = waves[:, :3] * _SWAY_M
    nod, shake, tilt = (np.deg2rad(_TURN_DEG) * waves[:, 3:]).T
    xyzw = scipy.spatial.transform.Rotation.from_euler("YXZ", np.stack([shake, nod, tilt], axis=-1)).as_quat()
    return HeadTrajectory(time_s, position, xyzw, f"synthetic head, seed {seed}")


def eye_motion(
    viewpoints_in_device: dict[str, FloatArray], seed: int, duration_s: float = 10.0, rate_hz: float = 500.0
) -> EyeTrajectory:
    """Return fixations of random points 0.4 m to 3 m ahead, with saccades between them.

    A saccade of A degrees lasts 21 ms + 2.2 ms * A (Carpenter 1988) and follows a minimum-jerk course.

    Args:
        viewpoints_in_device: entrance pupil of each eye when it looks straight ahead, (3,) metres.
        seed: seed of the fixations.
        duration_s: duration from time 0.
        rate_hz: samples per second.
    """
    rng = np.random.default_rng(seed)
    time_s = _sample_times(duration_s, rate_hz)
    point_in_device = _fixated_point(rng, time_s)
    tracks = {}
    for eye, viewpoint in viewpoints_in_device.items():
        model = RotatingEye.looking_ahead_from(viewpoint)
        gaze_dir = directions.normalised(point_in_device - model.rotation_centre_in_device)
        tracks[eye] = GazeTrack(time_s, gaze_dir, model, f"synthetic {eye} eye, seed {seed}")
    return EyeTrajectory(tracks, f"synthetic eyes, seed {seed}")


def _sample_times(duration_s: float, rate_hz: float) -> FloatArray:
    return np.asarray(np.arange(round(duration_s * rate_hz) + 1) / rate_hz)


def _slow_waves(rng: Generator, time_s: FloatArray) -> FloatArray:
    """Return six sums of three slow sine waves, (n, 6), each within -1..1."""
    phase = rng.uniform(0, 2 * np.pi, (6, _FREQUENCY_HZ.size))
    weight = rng.dirichlet(np.ones(_FREQUENCY_HZ.size), 6)
    angle = 2 * np.pi * _FREQUENCY_HZ * time_s[:, None, None] + phase
    return np.asarray((weight * np.sin(angle)).sum(axis=-1))


def _fixated_point(rng: Generator, time_s: FloatArray) -> FloatArray:
    """Return the point that both eyes fixate, (n, 3) device frame: random points, smoothly joined by saccades."""
    count = int(time_s[-1] / _FIXATION_S[0]) + 2
    onset_s = np.cumsum(rng.uniform(*_FIXATION_S, count))
    tangents = np.tan(np.deg2rad(np.clip(rng.normal(size=(count + 1, 2)), -2, 2) * _GAZE_SPREAD_DEG))
    view_dir = directions.dir_of_tangents(tangents)
    inverse_distance = rng.uniform(1 / 3.0, 1 / 0.4, count + 1)
    amplitude_deg = np.rad2deg(directions.angle_between(view_dir[:-1], view_dir[1:]))
    duration_s = 0.021 + 0.0022 * amplitude_deg
    x = np.clip((time_s[:, None] - onset_s) / duration_s, 0, 1)
    eased = minimum_jerk(x)
    here = tangents[0] + eased @ np.diff(tangents, axis=0)
    distance = 1 / (inverse_distance[0] + eased @ np.diff(inverse_distance))
    return np.asarray(directions.dir_of_tangents(here) * distance[:, None])
