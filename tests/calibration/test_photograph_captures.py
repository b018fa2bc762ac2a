"""What was read in photographs, carried into the device frame."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from wlr_render.calibration.photograph_captures import (
    joined_views,
    panel_captures,
    recorded_of,
    target_captures,
    within_field,
)
from wlr_render.captures.boards.board import BoardObservation
from wlr_render.captures.boards.board_design import design_board
from wlr_render.captures.decoded import DecodedSamples
from wlr_render.captures.photo_session import CodeSet, PhotoSession
from wlr_render.errors import BadInputError
from wlr_render.geometry import transforms
from wlr_render.geometry.directions import ARCMIN, arcmin_between, normalised
from wlr_render.lenses.lens_camera import LensCamera
from wlr_render.mappings import EyeBox, Panel

CAMERA = LensCamera((640, 480), np.array([700.0, 700.0]), np.array([320.0, 240.0]), np.array([-0.1, 0, 0, 0, 0]))
SESSION = cast(
    PhotoSession,
    SimpleNamespace(
        device="headset",
        eye="right",
        eye_box=EyeBox(np.zeros(3), np.full(3, 0.01)),
        pattern=SimpleNamespace(panel=Panel(20, 10)),
    ),
)
POSE = transforms.rigid(
    transforms.rotation_about("y", 0.1) @ transforms.OPENXR_FROM_OPENCV, np.array([0.002, 0.001, 0.03])
)


def test_a_target_seen_without_optics_lies_where_it_is_seen() -> None:
    board = design_board(8, 6, 0.03)
    target = POSE @ transforms.rigid(transforms.rotation_about("x", 0.3), np.array([0.02, -0.01, 0.5]))
    index = board.indices()
    point = transforms.apply(target, board.point_of(index))
    pixel = CAMERA.pixel_of_point(transforms.apply(transforms.inverse(POSE), point))
    observation = BoardObservation(index, pixel, np.full(len(index), 0.07))
    on_target = board.point_of(observation.index)
    captures = target_captures(SESSION, CAMERA, POSE, target, observation, on_target, target_pose=3, capture=5)
    straight = normalised(captures.point - captures.viewpoint)
    assert np.max(arcmin_between(captures.view_dir, straight)) < 1e-6
    assert set(captures.target_pose) == {3}
    assert set(captures.capture) == {5}
    assert captures.sigma_arcmin == pytest.approx(np.hypot(0.07, 0.01) / 700 / ARCMIN, rel=0.2)
    assert np.allclose(captures.viewpoint, [0.002, 0.001, 0.03])
    np.testing.assert_allclose(captures.target_point, board.point_of(index))


@pytest.mark.parametrize(
    "camera",
    [
        LensCamera((1200, 1200), np.full(2, 600.0), np.full(2, 600.0)),
        LensCamera((1200, 1200), np.array([600.0, 640.0]), np.full(2, 600.0), np.array([-0.05, 0.01, 0, 0, 0])),
        LensCamera((1200, 1200), np.full(2, 600.0), np.full(2, 600.0), np.array([0.03, 0, 0, 0]), "fisheye"),
    ],
    ids=["perspective", "brown", "fisheye"],
)
@pytest.mark.parametrize("angle_deg", [0.0, 25.0, 40.0])
def test_sigma_of_a_direction_is_that_of_its_pixel_at_every_angle(camera: LensCamera, angle_deg: float) -> None:
    ahead = transforms.rigid(transforms.OPENXR_FROM_OPENCV, np.zeros(3))
    axis = np.deg2rad(angle_deg)
    at = camera.pixel_of_point(np.array([np.sin(axis) * 0.8, np.sin(axis) * 0.6, np.cos(axis)]))
    noise = np.random.default_rng(1).normal(0.0, 0.1, (20_000, 2))
    count = len(noise)
    samples = DecodedSamples(at + noise, np.full((count, 2), 5.0), np.full(count, 0.1), np.ones(count))
    captures = panel_captures(SESSION, camera, ahead, samples, capture=0)
    mean = normalised(captures.view_dir.mean(axis=0))
    across = normalised(np.cross(mean, [0.0, 1.0, 0.0]))
    spread = np.cov(captures.view_dir @ np.stack([across, np.cross(mean, across)], axis=1), rowvar=False)
    true = np.linalg.det(spread) ** 0.25 / ARCMIN  # geometric mean of the two axes
    stated = np.median(captures.sigma_arcmin) * 0.1 / np.hypot(0.1, 0.01)
    assert stated == pytest.approx(true, rel=0.02)


def test_what_is_recorded_of_photographs_is_kept_and_the_camera_looks_along_its_minus_z() -> None:
    samples = DecodedSamples(np.full((3, 2), 200.5), np.full((3, 2), 5.0), np.full(3, 0.1), np.full(3, 2.0))
    taken = CodeSet(Path("set"), stage=np.array([0.01, 0.02]), channel="blue", time_s=40.0)
    first = panel_captures(SESSION, CAMERA, POSE, samples, capture=0, **recorded_of(taken))
    captures = joined_views([first, panel_captures(SESSION, CAMERA, POSE, samples, capture=1)], "the panel")
    assert captures.channel.tolist() == [2, 2, 2, -1, -1, -1]
    np.testing.assert_array_equal(captures.time_s[:3], 40.0)
    np.testing.assert_array_equal(captures.stage[:3], [[0.01, 0.02]] * 3)
    assert np.isnan(captures.stage[3:]).all()
    assert np.isnan(captures.temperature_c).all()
    np.testing.assert_allclose(-captures.device_from_camera[:, :, 2], [POSE[:3, 2]] * 6)
    np.testing.assert_allclose(np.linalg.det(captures.device_from_camera), 1.0)


def test_decoded_noise_becomes_an_angle_by_the_scale_of_the_picture() -> None:
    pixel = np.array([[330.5, 240.0], [320.0, 240.0]])
    samples = DecodedSamples(pixel, np.array([[5.0, 6.0], [7.0, 8.0]]), np.array([0.1, 0.2]), np.array([2.0, 2.0]))
    captures = panel_captures(SESSION, CAMERA, POSE, samples, capture=0)
    # 0.1 panel pixels at 2 panel pixels a camera pixel are 0.05 camera pixels.
    assert captures.sigma_arcmin == pytest.approx(np.hypot([0.05, 0.1], 0.01) / 700 / ARCMIN, rel=1e-3)
    assert captures.capture.tolist() == [0, 0]
    assert np.allclose(captures.view_dir[1], POSE[:3, 2])  # the middle of the picture is the optical axis
    assert captures.pixel.tolist() == [[5, 6], [7, 8]]


def test_no_views_are_refused() -> None:
    with pytest.raises(BadInputError, match="no photographs of the panel are left"):
        joined_views([], "the panel")


def test_dots_beyond_the_panel_s_field_are_left_out() -> None:
    board = design_board(20, 16, 0.03)
    target = POSE @ transforms.rigid(np.eye(3), np.array([0.0, 0.0, 0.6]))
    index = board.indices()
    point = transforms.apply(target, board.point_of(index))
    pixel = CAMERA.pixel_of_point(transforms.apply(transforms.inverse(POSE), point))
    observation = BoardObservation(index, pixel, np.full(len(index), 0.05))
    on_target = board.point_of(index)
    see_through = target_captures(SESSION, CAMERA, POSE, target, observation, on_target, capture=0, target_pose=0)
    corners = np.array([[200.0, 160.0], [440.0, 320.0]])
    samples = DecodedSamples(corners, np.zeros((2, 2)), np.ones(2), np.ones(2))
    display = panel_captures(SESSION, CAMERA, POSE, samples, capture=0)
    kept = within_field(see_through, display)
    seen = CAMERA.pixel_of_point(transforms.apply(transforms.inverse(POSE), kept.point))
    # The field is a box of tangents in the device frame, a twentieth larger on each side.
    assert 0 < len(kept) < len(see_through)
    assert np.all((seen > corners[0] - 20) & (seen < corners[1] + 20))
    aside = replace(see_through, view_dir=normalised(see_through.view_dir + [3.0, 0.0, 0.0]))
    with pytest.raises(BadInputError, match="no dot of the target was seen in the directions of the panel"):
        within_field(aside, display)
