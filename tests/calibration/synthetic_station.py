"""A calibration station made of numbers: what a lab's dots would be, with faults to inject."""

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from wlr_render.calibration.board_poses import BoardView, poses_of
from wlr_render.calibration.poses import small_motion
from wlr_render.calibration.station import StationPhotos, find_station
from wlr_render.calibration.sweep_checks import RepeatedView
from wlr_render.captures.boards.dot_board import DotBoard
from wlr_render.captures.photo_session import BoardPhotograph
from wlr_render.geometry import transforms
from wlr_render.geometry.lens_camera import LensCamera

NOISE_PX = 0.03
EYEBALL = LensCamera(
    (1280, 1024), np.array([1400.0, 1402.0]), np.array([652.0, 505.0]), np.array([-0.11, 0.08, 4e-4, -3e-4, 0.0])
)
TRACKING = LensCamera(
    (1280, 800), np.array([620.0, 621.0]), np.array([633.0, 411.0]), np.array([-0.05, 0.02, 1e-4, 2e-4, 0.0])
)
BOARD = DotBoard(0.015, 0.0075, 0.004, 0.02, np.random.default_rng(3).random((18, 24)) < 0.5)


def board_view(name, camera, camera_from_board, rng, every=1, point=None):
    """The dots that fall into the picture, with noise."""
    point = BOARD.point_of(BOARD.indices()[::every]) if point is None else point
    pixel = camera.pixel_of_point(transforms.apply(camera_from_board, point))
    inside = np.all((pixel > 5) & (pixel < np.array(camera.size_px) - 5), axis=1)
    pixel = pixel[inside] + NOISE_PX * rng.normal(size=(inside.sum(), 2))
    return BoardView(name, point[inside], pixel, np.full(inside.sum(), NOISE_PX))


def turned(x_deg, y_deg, z_deg):
    x, y, z = np.radians([x_deg, y_deg, z_deg])
    return transforms.rotation_about("x", x) @ transforms.rotation_about("y", y) @ transforms.rotation_about("z", z)


def tilted_poses(distance_m=0.5, tilt_deg=25.0):
    """camera_from_board, (9, 4, 4): straight, and tilted to eight sides."""
    angles = np.arange(8) * np.pi / 4
    tilts = [(0.0, 0.0)] + [(tilt_deg * np.cos(a), tilt_deg * np.sin(a)) for a in angles]
    return np.array(
        [transforms.rigid(turned(x, y, 20 * i), [0.01 * i - 0.04, 0.02, distance_m]) for i, (x, y) in enumerate(tilts)]
    )


def lens_views(rng, every=4, camera=EYEBALL, poses=None):
    poses = tilted_poses() if poses is None else poses
    return [board_view(f"lens/{i:02d}.png", camera, pose, rng, every) for i, pose in enumerate(poses)]


STAGE_AXES = np.array([[0.9998, 0.004, 0.0], [-0.003, 1.0001, 0.0], [0.012, -0.008, 1.0]])  # camera frame
CAMERA_FROM_TARGET = {0: transforms.rigid(turned(4, -6, 1), [0.01, -0.005, 0.5])}


def stage_grid(half_m=0.008, steps=5):
    x, y = np.meshgrid(np.linspace(-half_m, half_m, steps), np.linspace(-half_m, half_m, steps))
    return np.stack([x.ravel() + 0.05, y.ravel() + 0.03, np.full(x.size, 0.01)], axis=-1)


REFERENCE = np.array([0.05, 0.03, 0.01])
DEVICE_FROM_CAMERA = transforms.rigid(turned(1, 2, -0.5) @ transforms.OPENXR_FROM_OPENCV, [0.031, 0.002, 0.018])
DEVICE_FROM_TRACKING = transforms.rigid(turned(-12, 3, 0) @ transforms.OPENXR_FROM_OPENCV, [0.005, 0.03, -0.06])
SHIFT = small_motion(np.array([0.002, -0.001, 0.0, 2e-4, 5e-4, 0.0]))


@dataclass(frozen=True)
class Faults:
    """What goes wrong; nothing by default. Motions are 4 x 4, in the device's frame."""

    target_moved_before_tracking: dict = field(default_factory=dict)  # target pose -> motion
    target_moved_in_sweep: dict = field(default_factory=dict)
    headset_shifted_in_sweep: dict = field(default_factory=dict)
    camera_moved_in_sweep: dict = field(default_factory=dict)
    bow_m: float = 0.0
    reading_factor: float = 1.0
    moved_photograph: int | None = None
    printed_scale: float = 1.0
    smooth_rotation_rad: float = 0.0  # roll, pitch and yaw of the stage, rms over its travel, the same at every visit
    random_rotation_rad: float = 0.0  # the same, drawn anew at every visit


def stage_rotation(reading, rms_rad):
    """Roll, pitch and yaw (..., 3), of about `rms_rad` each, that vary smoothly with the reading."""
    x, y = np.moveaxis((reading - REFERENCE)[..., :2] / 0.008, -1, 0)
    roll = 1.2 * x + 0.7 * y
    pitch = 1.4 * np.sin(2.2 * x + 0.5) - 0.3 * y
    yaw = 1.5 * y**2 - 0.6 + 0.8 * x
    return rms_rad * np.stack([roll, pitch, yaw], axis=-1)


def device_from_camera(reading, bow_m=0.0, smooth_rotation_rad=0.0):
    travel = reading - REFERENCE
    bow = bow_m * (travel[..., :1] / 0.008) ** 2 * np.array([0.0, 0.0, 1.0])
    rotation = stage_rotation(reading, smooth_rotation_rad)
    motion = np.concatenate([rotation, np.zeros_like(rotation)], axis=-1)
    return DEVICE_FROM_CAMERA @ transforms.rigid(np.eye(3), travel @ STAGE_AXES.T + bow) @ small_motion(motion)


def device_from_target(k):
    distance, tilt = [0.5, 0.9, 0.65][k], [(4, -6, 1), (-5, 8, -2), (3, 5, 0)][k]
    return DEVICE_FROM_CAMERA @ transforms.rigid(turned(*tilt), [0.01, -0.005, distance])


def visited(reading, faults, rng):
    """device_from_camera at one visit to a reading."""
    draw = faults.random_rotation_rad * rng.normal(size=3) if faults.random_rotation_rad else np.zeros(3)
    true = device_from_camera(reading, faults.bow_m, faults.smooth_rotation_rad)
    return true @ small_motion(np.concatenate([draw, np.zeros(3)]))


@dataclass(frozen=True)
class Bench:
    """All photographs of one run of the procedure."""

    bare: list
    tracking: list
    repeated: list
    photos: StationPhotos


def bench(seed, faults=Faults(), bare_targets=(0, 1), targets=(0, 1), steps=4):
    rng = np.random.default_rng(seed)
    bare, bare_photos = [], []
    grid = stage_grid(steps=steps)
    for k in bare_targets:
        for reading in grid:
            name = f"bare/{len(bare):02d}.png"
            camera = visited(reading, faults, rng)
            camera_from_target = transforms.inverse(camera) @ device_from_target(k)
            if faults.moved_photograph == len(bare):
                camera_from_target = SHIFT @ camera_from_target
            bare.append(scaled(board_view(name, EYEBALL, camera_from_target, rng, 5), faults.printed_scale))
            bare_photos.append(BoardPhotograph(Path(), name, k, reading * faults.reading_factor))
    tracking, tracking_photos, repeated = [], [], []
    identity = np.eye(4)
    for k in targets:
        target = faults.target_moved_before_tracking.get(k, identity) @ device_from_target(k)
        moved_target = faults.target_moved_in_sweep.get(k, identity) @ target
        headset = faults.headset_shifted_in_sweep.get(k, identity)
        for when, world_from_target, world_from_device in (("a", target, identity), ("b", moved_target, headset)):
            name = f"tracking/{k}{when}.png"
            tracking_from_target = transforms.inverse(world_from_device @ DEVICE_FROM_TRACKING) @ world_from_target
            tracking.append(scaled(board_view(name, TRACKING, tracking_from_target, rng, 3), faults.printed_scale))
            tracking_photos.append(BoardPhotograph(Path(), name, k))
        camera = device_from_camera(grid[0])
        moved_camera = faults.camera_moved_in_sweep.get(k, identity) @ camera
        first, last = (
            scaled(
                board_view(f"through/{k}{when}.png", EYEBALL, transforms.inverse(c) @ t, rng, 5), faults.printed_scale
            )
            for when, c, t in (("a", camera, target), ("b", moved_camera, moved_target))
        )
        repeated.append(RepeatedView(k, grid[0] * faults.reading_factor, first, last))
    return Bench(bare, tracking, repeated, StationPhotos(bare_photos, tracking_photos, repeated))


def scaled(view, factor):
    """As a lab has it that believes in a pitch `factor` times the real one."""
    return replace(view, point=view.point * factor)


def station_of(made, eyeball=None):
    seen = poses_of(EYEBALL, made.bare) if eyeball is None else eyeball
    return find_station(made.photos, seen, poses_of(TRACKING, made.tracking), DEVICE_FROM_TRACKING)
