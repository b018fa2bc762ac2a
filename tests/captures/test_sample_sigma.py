"""Stated against actual error of samples, from the panel's pixels to `sample`, with faults that the decoder ignores."""

from collections.abc import Callable, Iterator
from typing import Any

import cv2
import numpy as np
import pytest

from wlr_render.captures.decoded import sample
from wlr_render.captures.patterns.catalogue import make_pattern
from wlr_render.captures.patterns.pattern import Pattern
from wlr_render.mappings import Panel
from wlr_render.numerics.arrays import Float32Array, FloatArray

PANEL = Panel(160, 130)
WIDTH, HEIGHT, RIM = 110, 84, 4  # camera pixels; the rim keeps the blur of the picture's border out
FINE = 10  # samples of a camera pixel, each way


def mapping(rng: np.random.Generator, scale: float) -> Callable[[Any, Any], tuple[Any, Any]]:
    """Panel position of places in the picture: turned, with distortion and perspective, shifted at random."""
    shift = rng.uniform(-3, 3, 2)

    def position(x: FloatArray, y: FloatArray) -> tuple[Any, Any]:
        x, y = x - WIDTH / 2, y - HEIGHT / 2
        stretch = scale * (1 + 0.003 * (x * x + y * y) / WIDTH**2) / (1 + 0.003 * x / WIDTH)
        across, down = x * np.cos(0.03) - y * np.sin(0.03), x * np.sin(0.03) + y * np.cos(0.03)
        return PANEL.width_px / 2 + shift[0] + stretch * across, PANEL.height_px / 2 + shift[1] + stretch * down

    return position


def motion(rng: np.random.Generator, length_px: float) -> Float32Array:
    """Kernel of a camera that moves along a line of random direction during the exposure."""
    size = 2 * int(np.ceil(length_px * FINE)) + 1
    kernel, way = np.zeros((size, size), np.float32), np.linspace(-0.5, 0.5, 201) * length_px * FINE
    angle = rng.uniform(0, np.pi)
    places = [np.rint(size // 2 + way * part).astype(int) for part in (np.sin(angle), np.cos(angle))]
    np.add.at(kernel, tuple(places), 1 / 201)
    return kernel


def photographs(
    pattern: Pattern,
    position: Callable[..., Any],
    rng: np.random.Generator,
    noise: float,
    black: int = 12,
    blur_px: float = 0.4,
    motion_px: float = 0.5,
    gamma: float = 1.05,
) -> Iterator[Any]:
    """8-bit photographs; noise of photons and reading, blur of the lens, vibration, 5 % error of gamma."""
    grid = [(np.arange((size + 2 * RIM) * FINE) + 0.5) / FINE - RIM for size in (WIDTH, HEIGHT)]
    x, y = (place + rng.uniform(-0.5, 0.5, place.shape) / FINE for place in np.meshgrid(*grid))
    u, v = (np.floor(place).astype(int) for place in position(x, y))
    for index in range(len(pattern.names())):
        light = (pattern.image(index) / 255).astype(np.float32)[v, u]
        light = cv2.GaussianBlur(cv2.filter2D(light, -1, motion(rng, motion_px)), (0, 0), blur_px * FINE)
        inner = light[RIM * FINE : -RIM * FINE, RIM * FINE : -RIM * FINE]
        grey = np.maximum(cv2.resize(inner, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA), 0) ** (1 / gamma)
        grey = black + 190 * grey + rng.normal(0, noise, grey.shape) * np.sqrt(0.3 + 0.7 * grey)
        yield np.clip(np.round(grey), 0, 255).astype(np.uint8)


def stated_over_actual(name: str, noise: float, black: int = 12) -> float:
    """Ratio of rms sigma and rms error of samples at three places of the camera."""
    pattern, errors, stated = make_pattern(name, PANEL), [], []
    for seed, scale in enumerate((0.8, 0.95, 1.1)):
        rng = np.random.default_rng(seed)
        position = mapping(rng, scale)
        samples = sample(pattern.decode(photographs(pattern, position, rng, noise, black)), 300)
        errors.append(samples.panel_pixel - np.stack(position(*samples.camera_pixel.T), axis=-1))
        stated.append(samples.sigma_px)
    return float(np.sqrt(np.mean(np.concatenate(stated) ** 2) / np.mean(np.concatenate(errors) ** 2)))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["gray-fringes", "gray"])
@pytest.mark.parametrize("noise", [2.0, 4.0])
def test_stated_sigmas_are_the_actual_errors(name: str, noise: float) -> None:
    assert 0.8 < stated_over_actual(name, noise) < 1.25


@pytest.mark.slow
@pytest.mark.parametrize("name", ["gray-fringes", "gray"])
def test_black_that_is_clipped_makes_no_sigma_too_small(name: str) -> None:
    assert 0.8 < stated_over_actual(name, 2.0, black=-15) < 2
