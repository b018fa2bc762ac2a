"""Surfaces of which the truth is known: how many, where, and what they leave."""

from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from benchmarks.published_data.flat_surfaces import Lenses, distance_to_planes, find_planes, fit_planes
from wlr_render.captures.decoded import Decoded
from wlr_render.lenses.lens_camera import LensCamera
from wlr_render.numerics.arrays import BoolArray, FloatArray

LEFT = np.array([[0.7, 0.02, 30.0], [-0.01, 0.8, 20.0], [1e-5, 2e-5, 1.0]])
RIGHT = np.array([[0.75, -0.03, 60.0], [0.03, 0.7, 5.0], [-4e-5, 1e-5, 1.0]])
HEIGHT, WIDTH = 160, 240
LENS = LensCamera(
    (WIDTH, HEIGHT), np.array([300.0, 310.0]), np.array([118.0, 83.0]), np.array([-0.2, 0.05, 0.001, 0, 0])
)


def centres() -> NDArray[Any]:
    column, row = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    return np.stack([column, row], axis=-1)


def mapped(homography: FloatArray, pixel: FloatArray) -> FloatArray:
    return np.asarray(cv2.perspectiveTransform(pixel.reshape(-1, 1, 2), homography).reshape(pixel.shape))


def decoded_of(position: FloatArray, accepted: BoolArray | None = None) -> Decoded:
    rejection = np.zeros((HEIGHT, WIDTH), np.uint8) if accepted is None else (~accepted).astype(np.uint8)
    pixel = np.where((rejection == 0)[..., None], position, np.nan).astype(np.float32)
    sure = np.ones((HEIGHT, WIDTH), np.float32)
    return Decoded(pixel, sure, sure, rejection, sure, np.ones(rejection.shape, np.uint8))


def two_surfaces(noise_px: float = 0.0) -> Any:
    pixel = centres()
    position = np.where(pixel[..., :1] < 140, mapped(LEFT, pixel), mapped(RIGHT, pixel))
    return position + noise_px * np.random.default_rng(5).standard_normal(position.shape)


def test_two_surfaces_are_separated_and_their_noise_is_measured() -> None:
    position, inside = two_surfaces(noise_px=0.1), centres()[..., 0] < 140
    accepted = np.random.default_rng(1).random((HEIGHT, WIDTH)) < 0.9
    label = find_planes(decoded_of(position, accepted))
    assert np.all(label[~accepted] == -1)
    assert np.mean((label == 0)[accepted] == inside[accepted]) > 0.999
    survey = fit_planes(decoded_of(position, accepted), label)
    assert len(survey.planes) == 2
    for plane, truth in zip(survey.planes, (LEFT, RIGHT), strict=True):
        near = centres()[inside if truth is LEFT else ~inside]
        np.testing.assert_allclose(mapped(plane.homography, near), mapped(truth, near), atol=0.02)
        assert plane.rms_per_axis == pytest.approx(0.1, rel=0.03)
        assert plane.scatter_per_axis == pytest.approx(0.1, rel=0.03)
        assert plane.smooth_per_axis < 0.015
    assert sum(plane.share for plane in survey.planes) > 0.999


def test_a_smooth_deviation_is_no_scatter() -> None:
    position = mapped(LEFT, centres())
    position[..., 0] += 0.2 * np.sign(np.sin(centres()[..., 1] / 16 * np.pi))  # constant in a cell, changing between
    decoded = decoded_of(position)
    (plane,) = fit_planes(decoded, np.zeros((HEIGHT, WIDTH), np.int8)).planes
    assert plane.smooth_per_axis == pytest.approx(0.2 / np.sqrt(2), rel=0.02)
    assert plane.scatter_per_axis < 0.005


def test_distortion_of_either_lens_is_taken_away() -> None:
    straight = LENS.tangents_of_pixel(centres()) * LENS.focal_px + LENS.centre_px
    label = np.zeros((HEIGHT, WIDTH), np.int8)
    seen = decoded_of(mapped(LEFT, straight))
    assert fit_planes(seen, label).planes[0].residual.maximum > 0.5
    assert fit_planes(seen, label, Lenses(camera=LENS)).planes[0].residual.maximum < 1e-3

    shown = mapped(LEFT, centres())
    through_projector = decoded_of(LENS.pixel_of_tangents((shown - LENS.centre_px) / LENS.focal_px))
    assert fit_planes(through_projector, label).planes[0].residual.maximum > 0.5
    assert fit_planes(through_projector, label, Lenses(projector=LENS)).planes[0].residual.maximum < 1e-3


def test_positions_without_any_surface_have_none() -> None:
    rng = np.random.default_rng(2)
    decoded = decoded_of(rng.uniform(0, 500, (HEIGHT, WIDTH, 2)))
    label = find_planes(decoded)
    assert np.all(label == -1)
    assert fit_planes(decoded, label).planes == ()
    nothing = decoded_of(two_surfaces(), np.zeros((HEIGHT, WIDTH), dtype=bool))
    assert fit_planes(nothing, find_planes(nothing)).planes == ()


def test_the_distance_is_to_the_nearest_surface() -> None:
    planes = fit_planes(decoded_of(two_surfaces()), find_planes(decoded_of(two_surfaces()))).planes
    seen = np.array([[50.5, 40.5], [50.5, 40.5], [50.5, 40.5]])
    shown = np.stack([mapped(LEFT, seen[0]), mapped(RIGHT, seen[0]), mapped(RIGHT, seen[0]) + [0.3, 0.4]])
    np.testing.assert_allclose(distance_to_planes(planes, seen, shown), [0.0, 0.0, 0.5], atol=0.01)
    assert np.all(np.isinf(distance_to_planes((), seen, shown)))
