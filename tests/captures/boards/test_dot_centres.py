"""Dots drawn with known centres and areas are found and measured."""

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from wlr_render.captures.boards.dot_centres import MeasuredDots, measure_dots
from wlr_render.captures.boards.dot_lattice import find_dots
from wlr_render.numerics.arrays import FloatArray, IntArray

FINE = 8  # rays per pixel and axis


def drawn(
    centres: FloatArray, half_axes: FloatArray, turn_rad: float, size: tuple[int, int] = (240, 320), dot: float = 0.1
) -> FloatArray:
    """(h, w) light of ellipses on white 1."""
    light = np.ones((FINE * size[0], FINE * size[1]))
    c, s = np.cos(turn_rad), np.sin(turn_rad)
    for (x, y), (a, b) in zip(centres, half_axes, strict=True):
        low = np.maximum(np.array([y, x]) - max(a, b) - 1, 0).astype(int) * FINE
        part = light[low[0] : low[0] + int(2 * max(a, b) + 3) * FINE, low[1] : low[1] + int(2 * max(a, b) + 3) * FINE]
        dv, du = ((np.arange(n) + 0.5 + start) / FINE for n, start in zip(part.shape, low, strict=True))
        du, dv = du[None, :] - x, dv[:, None] - y
        part[((c * du + s * dv) / a) ** 2 + ((c * dv - s * du) / b) ** 2 < 1] = dot
    return np.asarray(light.reshape(size[0], FINE, size[1], FINE).mean(axis=(1, 3)))


def scattered(diameter: float, seed: int = 1) -> FloatArray:
    """Centres on a loose grid, off by parts of a pixel."""
    pitch = max(16.0, min(2.5 * diameter, 90.0))
    u, v = np.meshgrid(np.arange(pitch, 320 - 0.7 * pitch, pitch), np.arange(pitch, 240 - 0.7 * pitch, pitch))
    grid = np.stack([u, v], axis=-1).reshape(-1, 2)
    return grid + np.random.default_rng(seed).uniform(-0.5, 0.5, grid.shape)


def measured(
    image: NDArray[np.uint16] | NDArray[np.uint8], centres: FloatArray
) -> tuple[FloatArray, MeasuredDots, IntArray]:
    """What is measured of each true dot."""
    dots = find_dots(image)
    assert len(dots) == len(centres), "dots were missed or seen twice"
    found = measure_dots(image, dots, np.arange(len(dots)))
    order = np.array([np.argmin(np.linalg.norm(dots.centre - centre, axis=1)) for centre in centres])
    return found.dots.centre[order], found, order


@pytest.mark.parametrize("blur_px", [0.0, 1.2])
@pytest.mark.parametrize("diameter", [6.0, 9.0, 20.0, 60.0])
def test_centre_and_area_are_not_biased_by_size_or_blur(diameter: float, blur_px: float) -> None:
    centres = scattered(diameter)
    light = drawn(centres, np.full((len(centres), 2), 0.5 * diameter), 0.0)
    light = cv2.GaussianBlur(light, (0, 0), blur_px) if blur_px else light
    seen, found, order = measured(np.rint(50000 * light).astype(np.uint16), centres)
    assert np.sqrt(np.mean((seen - centres) ** 2)) < 0.01
    area = found.darkness_px2[order] / 0.9
    assert area == pytest.approx(0.25 * np.pi * diameter**2, rel=0.03)


def test_slanted_dots_keep_their_centres_and_shapes() -> None:
    centres = scattered(14.0)
    light = drawn(centres, np.tile([7.0, 4.0], (len(centres), 1)), 0.6)
    seen, found, order = measured((200 * light).astype(np.uint8), centres)
    assert np.sqrt(np.mean((seen - centres) ** 2)) < 0.015
    squares = np.linalg.eigvalsh(found.dots.spread[order])
    assert 2 * np.sqrt(squares) == pytest.approx(np.tile([4.0, 7.0], (len(centres), 1)), rel=0.04)


def test_light_that_falls_off_does_not_shift_dots() -> None:
    centres = scattered(20.0)
    light = drawn(centres, np.full((len(centres), 2), 10.0), 0.0)
    slope = np.linspace(1.0, 0.2, light.shape[1])
    seen, _, _ = measured(np.rint(50000 * light * slope).astype(np.uint16), centres)
    assert np.abs((seen - centres).mean(axis=0)).max() < 0.004


@pytest.mark.parametrize(("diameter", "snr"), [(7.0, 20), (16.0, 20), (16.0, 60), (40.0, 20)])
def test_sigma_is_what_noise_does(diameter: float, snr: int) -> None:
    centres = scattered(diameter)
    light = drawn(centres, np.full((len(centres), 2), 0.5 * diameter), 0.0)
    rng = np.random.default_rng(5)
    pulls = []
    for _ in range(6):
        image = np.clip(np.rint(200 * light + rng.normal(0, 200 / snr, light.shape)), 0, 255).astype(np.uint8)
        seen, found, order = measured(image, centres)
        pulls.append((seen - centres) / found.sigma_px[order, None])
    assert np.sqrt(np.mean(np.square(pulls))) == pytest.approx(1.0, abs=0.3)


def test_a_dot_cut_off_by_the_picture_is_not_measured() -> None:
    light = drawn(np.array([[4.0, 60.0], [100.0, 60.0]]), np.full((2, 2), 6.0), 0.0)
    image = (200 * light).astype(np.uint8)
    dots = find_dots(image)
    assert len(dots) == 1
    assert np.allclose(dots.centre, [[100.0, 60.0]], atol=0.3)
    # Even where it is known to be there.
    there = type(dots)(np.array([[4.0, 60.0], [100.0, 60.0]]), np.tile(9.0 * np.eye(2), (2, 1, 1)))
    found = measure_dots(image, there, np.arange(2))
    assert np.isnan(found.dots.centre[0]).all()
    assert np.isnan(found.sigma_px[0])
    assert np.allclose(found.dots.centre[1], [100.0, 60.0], atol=0.01)
