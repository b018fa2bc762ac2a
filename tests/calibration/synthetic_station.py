"""A calibration station made of numbers: what a lab's dots would be, with faults to inject."""

import numpy as np

from wlr_render.calibration.board_views import BoardView
from wlr_render.captures.targets.dot_board import DotBoard
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
