"""What a session consists of: where the camera stands, when, and where the targets stand. Millimetres, seconds."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from oracle.own_tracer import FloatArray, turn

DISPLAY = -1
"""What `Captures.target_pose` holds for captures of the display."""

CAMERA_SIZE_PX = np.array([1280.0, 1024.0])
CAMERA_FOCAL_PX = 1350.0
CAMERA_CENTRE_PX = np.array([640.0, 512.0])

TARGET_DISTANCES_MM = (600.0, 1100.0, 2200.0)
_TARGET_TURNS_DEG = ((-6.0, 4.0, 0.0), (5.0, -8.0, 0.0), (9.0, 3.0, 0.0))
_TARGET_WIDTH = 0.72  # of its distance

_PLANE_MM = np.array([5.0, 4.0])  # half the base plane
_OFF_PLANE_MM = np.array([4.5, 3.5, 3.0])  # half the box of the captures off the plane
_PLANE_AHEAD_MM = 3.0  # the base plane lies that far before the middle of the eye box
_DISPLAY_EVERY_S, _SEE_THROUGH_EVERY_S = 40.0, 30.0
_SEE_THROUGH_FROM_S, _POSE_EVERY_S = 2400.0, 600.0
_SEE_THROUGH_NODES = 4  # per axis


@dataclass(frozen=True)
class Plan:
    """How large a session is; the defaults are those of a full one.

    Attributes:
        device: name of the headset.
        grid: columns and rows of camera pixels at which the display is decoded.
        dots: columns and rows of the targets.
        nodes: Chebyshev positions per axis of the base plane, 4 or more.
        off_plane: display captures off that plane.
        sigma_px: noise of a point per axis, camera pixels; stated in the bench file, and true.
        channels: colours that the display shows at every point; 0 red, 1 green, 2 blue.
    """

    device: str = "northstar"
    grid: tuple[int, int] = (24, 20)
    dots: tuple[int, int] = (21, 15)
    nodes: int = 6
    off_plane: int = 12
    sigma_px: float = 0.1
    channels: tuple[int, ...] = (1,)

    def pitch_mm(self, target_pose: int) -> float:
        """Distance between the dots of one target."""
        return round(_TARGET_WIDTH * TARGET_DISTANCES_MM[target_pose] / (self.dots[0] - 1), 6)


@dataclass(frozen=True, eq=False)
class Captures:
    """The captures of one table, in order of time.

    Attributes:
        target_pose: (c,) which target stands before the camera, or `DISPLAY`.
        number: (c,) counts from 0 for the display, and again for each target pose.
        time_s: (c,) since the session began.
        travel: (c,) +1 or -1, as the session states the direction of the last move along x.
        reading: (c, 3) what the micrometers say, device frame.
    """

    target_pose: NDArray[np.int64]
    number: NDArray[np.int64]
    time_s: FloatArray
    travel: NDArray[np.int64]
    reading: FloatArray


def stage_origin(eye: FloatArray) -> FloatArray:
    """Middle of the base plane, (3,), for the middle of the eye box (3,)."""
    return np.asarray(eye + np.array([0.0, 0.0, _PLANE_AHEAD_MM]))


def display_captures(plan: Plan, eye: FloatArray, rng: np.random.Generator) -> Captures:
    """A serpentine over the Chebyshev nodes of the base plane, then random positions off it."""
    offsets, travel = _serpentine(plan.nodes, np.arange(plan.nodes))
    off_plane = rng.uniform(-1.0, 1.0, (plan.off_plane, 3)) * _OFF_PLANE_MM + eye
    reading = np.round(np.concatenate([offsets + stage_origin(eye), off_plane]), 6)
    number = np.arange(len(reading))
    return Captures(
        target_pose=np.full(len(reading), DISPLAY),
        number=number,
        time_s=np.asarray(_DISPLAY_EVERY_S * number, dtype=np.float64),
        travel=np.concatenate([travel, np.ones(plan.off_plane, dtype=np.int64)]),
        reading=reading,
    )


def see_through_captures(plan: Plan, eye: FloatArray) -> Captures:
    """Part of the base plane's nodes once for each target; every position is approached in +x."""
    chosen = np.round(np.linspace(0, plan.nodes - 1, _SEE_THROUGH_NODES)).astype(np.int64)
    offsets, _ = _serpentine(plan.nodes, chosen)
    poses, count = len(TARGET_DISTANCES_MM), len(offsets)
    pose, number = np.repeat(np.arange(poses), count), np.tile(np.arange(count), poses)
    return Captures(
        target_pose=pose,
        number=number,
        time_s=_SEE_THROUGH_FROM_S + _POSE_EVERY_S * pose + _SEE_THROUGH_EVERY_S * number,
        travel=np.ones(len(pose), dtype=np.int64),
        reading=np.asarray(np.round(np.tile(offsets + stage_origin(eye), (poses, 1)), 6), dtype=np.float64),
    )


def device_from_target(target_pose: int, eye: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Rotation (3, 3) and translation (3,) of a target as the session states them, to nine decimals."""
    rotation = np.round(turn(np.radians(_TARGET_TURNS_DEG[target_pose])), 9)
    return rotation, np.array([eye[0], eye[1], TARGET_DISTANCES_MM[target_pose]])


def _serpentine(nodes: int, chosen: NDArray[np.int64]) -> tuple[FloatArray, NDArray[np.int64]]:
    """Offsets from the plane's middle, (n, 3), row by row, every other *node* row backwards; and the stated travel.

    Measured sessions call a row +1 in which x falls from node to node, and so do these.
    """
    unit_nodes = np.cos((2 * np.arange(nodes) + 1) * np.pi / (2 * nodes))
    offsets, travel = [], []
    for row in chosen:
        backwards = row % 2 == 1
        for column in chosen[::-1] if backwards else chosen:
            offsets.append([*(_PLANE_MM * unit_nodes[[column, row]]), 0.0])
            travel.append(-1 if backwards else 1)
    return np.array(offsets), np.array(travel)
