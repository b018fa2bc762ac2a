from typing import Any

import numpy as np
import pytest

from benchmarks.simulated_lab import exact_views
from wlr_render.captures.boards.dot_board import DotBoard
from wlr_render.geometry.transforms import OPENXR_FROM_OPENCV, apply, inverse, rigid, rotation_about
from wlr_render.lenses.lens_camera import LensCamera
from wlr_render.numerics.arrays import Float32Array, FloatArray
from wlr_render.optics.device_file import load_device
from wlr_render.simulation.photographs.board_light import BoardLight, FarWall
from wlr_render.simulation.photographs.camera import SimulatedLens
from wlr_render.simulation.photographs.camera_view import CameraView

CAMERA = LensCamera((320, 240), np.array([400.0, 400.0]), np.array([161.0, 118.0]), np.array([-0.1, 0.02, 1e-3, 0, 0]))
LENS = SimulatedLens(CAMERA, 0.002, 0.6)
LOOKING_AHEAD = rigid(OPENXR_FROM_OPENCV, np.zeros(3))
BOARD = DotBoard(0.03, 0.018, 0.010, 0.03, np.random.default_rng(4).random((5, 7)) < 0.5)
TILTED = rigid(
    OPENXR_FROM_OPENCV @ rotation_about("y", 0.25) @ rotation_about("x", -0.1), np.array([0.01, -0.02, -0.6])
)
BLACK_WALL = FarWall(brightness=0.0)


def darkness_around(light: Float32Array, pixel: FloatArray, white: float, radius: float = 6.0) -> tuple[Any, Any]:
    """Pixels' worth of dot at a place, and its middle."""
    v, u = np.indices(light.shape) + 0.5
    weight = np.where(np.hypot(u - pixel[0], v - pixel[1]) < radius, white - light, 0.0)
    return weight.sum(), np.array([(weight * u).sum(), (weight * v).sum()]) / weight.sum()


@pytest.mark.slow
def test_dots_lie_where_their_middles_are_seen_and_are_as_large_as_printed() -> None:
    # Small dots square before the camera: neither perspective nor the lens moves their middles.
    board = DotBoard(0.03, 0.012, 0.006, 0.03, np.zeros((3, 3), bool))
    camera = LensCamera((320, 240), np.array([400.0, 400.0]), np.array([161.0, 118.0]))
    pose = rigid(OPENXR_FROM_OPENCV, np.array([0.01, -0.02, -0.4]))
    scene = BoardLight(board, pose, white=0.8, black=0.0)
    light = CameraView.without_headset(SimulatedLens(camera, 0.001, 0.4), LOOKING_AHEAD, samples=64).world_light(scene)
    for point in board.point_of(board.indices()):
        pixel = camera.pixel_of_point(apply(inverse(LOOKING_AHEAD) @ pose, point))
        amount, middle = darkness_around(light, pixel, 0.8)
        np.testing.assert_allclose(middle, pixel, atol=0.02)
        assert amount / 0.8 == pytest.approx(np.pi * (400 * 0.003 / 0.4) ** 2, rel=0.03)


@pytest.mark.parametrize("name", ["plane_plate", "freeform40", "birdbath28"])
def test_dots_seen_through_optics_lie_where_exact_rays_say(name: str) -> None:
    eye = load_device(name).eyes["right"]
    light = CameraView.through_optics(eye, LENS, LOOKING_AHEAD).world_light(BoardLight(BOARD, TILTED, BLACK_WALL))
    points = apply(TILTED, BOARD.point_of(BOARD.indices()))
    pixels = exact_views.pixel_of_real_point(eye, CAMERA, LOOKING_AHEAD, points)
    inside = np.flatnonzero(np.all((pixels > 12) & (pixels < np.array(CAMERA.size_px) - 12), axis=-1))
    assert inside.size > 15
    for pixel in pixels[inside]:
        _, middle = darkness_around(light, pixel, 0.8, radius=9.0)
        np.testing.assert_allclose(middle, pixel, atol=0.1)  # a tilted dot's middle is not quite its centre's image


def test_beyond_the_board_is_the_wall() -> None:
    light = CameraView.without_headset(LENS, LOOKING_AHEAD, samples=4).world_light(
        BoardLight(BOARD, TILTED, BLACK_WALL)
    )
    half = 0.5 * BOARD.size_m
    corners = np.array([[x, y, 0] for x in (-1, 1) for y in (-1, 1)]) * [*half, 0]
    for scale, bright in [(0.97, True), (1.03, False)]:
        pixel = CAMERA.pixel_of_point(apply(inverse(LOOKING_AHEAD) @ TILTED, corners * scale)).astype(int)
        assert np.all((light[pixel[:, 1], pixel[:, 0]] > 0.7) == bright)


def test_a_board_is_not_seen_from_behind_nor_behind_the_camera() -> None:
    turned = TILTED @ rigid(rotation_about("y", np.pi), np.zeros(3))
    behind = rigid(OPENXR_FROM_OPENCV, np.array([0.0, 0.0, 0.6]))
    one = CameraView.without_headset(LENS, LOOKING_AHEAD, samples=2)
    wall = one.world_light(FarWall())
    for pose in (turned, behind):
        np.testing.assert_array_equal(one.world_light(BoardLight(BOARD, pose)), wall)


def test_the_wall_is_smooth_and_stays_within_its_contrast() -> None:
    wall = CameraView.without_headset(LENS, LOOKING_AHEAD, samples=2).world_light(FarWall(0.2, 0.5, 0.3))
    assert 0.1 <= wall.min() < 0.15
    assert 0.25 < wall.max() <= 0.3
    assert np.abs(np.diff(wall, axis=1)).max() < 0.2 * 0.5 * 2 * np.pi / 0.3 / 400 * 1.5


@pytest.mark.slow
def test_light_of_more_samples_converges() -> None:
    scene = BoardLight(BOARD, TILTED)
    few, many = (
        CameraView.without_headset(LENS, LOOKING_AHEAD, samples=count).world_light(scene) for count in (16, 128)
    )
    assert np.sqrt(np.mean((few - many) ** 2)) < 0.01
