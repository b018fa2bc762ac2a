"""Windows of a decoded picture: planes are kept exactly, noise is averaged, outliers are left out."""

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from wlr_render.captures.decoded import Decoded, Rejection, sample
from wlr_render.numerics.arrays import FloatArray


def decoded_plane(
    noise_px: float = 0.0, seed: int = 1, size: tuple[int, int] = (200, 160), smoothed: bool = True
) -> Decoded:
    """A picture whose panel position is affine in the camera pixel, all accepted; its noise is smoothed or white."""
    width, height = size
    u, v = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    panel = np.stack([30 + 1.5 * u + 0.1 * v, 20 - 0.05 * u + 1.3 * v], axis=-1)
    noise = np.random.default_rng(seed).normal(0, noise_px, panel.shape)
    panel = panel + (cv2.blur(3 * noise, (3, 3)) if smoothed else noise)
    ones = np.ones((height, width), np.float32)
    whole = np.ones((height, width), np.uint8)
    return Decoded(panel.astype(np.float32), noise_px * ones, ones, 0 * whole, noise_px * ones, whole)


def truth(camera_pixel: FloatArray) -> NDArray[Any]:
    u, v = camera_pixel.T
    return np.stack([30 + 1.5 * u + 0.1 * v, 20 - 0.05 * u + 1.3 * v], axis=-1)


def test_a_plane_is_kept_at_camera_pixel_centres() -> None:
    samples = sample(decoded_plane(), count=300)
    assert 150 < len(samples) < 600
    assert np.allclose(samples.panel_pixel, truth(samples.camera_pixel), atol=1e-4)
    assert np.allclose(samples.camera_pixel % 1.0, 0.5)
    assert np.allclose(samples.scale, np.sqrt(1.5 * 1.3 + 0.1 * 0.05), rtol=1e-4)


@pytest.mark.parametrize("size", [(7, 200), (1, 1), (8, 8)])
def test_a_picture_smaller_than_a_window_has_no_samples(size: tuple[int, int]) -> None:
    assert len(sample(decoded_plane(size=size))) == 0


def test_noise_is_averaged_and_its_size_told() -> None:
    samples = sample(decoded_plane(0.1), count=100)
    error = samples.panel_pixel - truth(samples.camera_pixel)
    assert np.sqrt(np.mean(error**2)) == pytest.approx(0.3 * 73 / 729, rel=0.25)
    assert np.sqrt(np.mean((error / samples.sigma_px[:, None]) ** 2)) == pytest.approx(1.0, abs=0.25)


def test_strays_and_rejected_pixels_do_not_move_a_sample() -> None:
    clean = decoded_plane(0.05)
    rng = np.random.default_rng(3)
    outlier, gone = rng.random((2, *clean.rejection.shape)) < 0.05
    pixel = np.where(outlier[..., None], clean.pixel + 200.0, clean.pixel)
    pixel[gone] = np.nan
    rejection = np.where(gone, Rejection.UNSURE_BIT, 0).astype(np.uint8)
    samples = sample(
        Decoded(pixel, clean.sigma_px, clean.confidence, rejection, clean.noise_px, clean.cell_px), count=300
    )
    error = samples.panel_pixel - truth(samples.camera_pixel)
    assert np.abs(error).max() < 0.05


def test_a_picture_without_accepted_pixels_gives_no_samples() -> None:
    empty = decoded_plane()
    rejection = np.full_like(empty.rejection, Rejection.DARK)
    pixel = np.full_like(empty.pixel, np.nan)
    assert len(sample(replace(empty, pixel=pixel, rejection=rejection))) == 0


def test_the_rim_of_what_is_accepted_is_not_used() -> None:
    """Beside the panel's edge blur mixes in what is dark, and positions are drawn inwards."""
    clean = decoded_plane(0.3, smoothed=False)
    rejection = np.zeros_like(clean.rejection)
    rejection[:, 100:] = Rejection.DARK
    pixel = clean.pixel.copy()
    pixel[:, 98:100] -= 1.0  # too little to be an outlier
    samples = sample(
        Decoded(pixel, clean.sigma_px, clean.confidence, rejection, clean.noise_px, clean.cell_px), count=2000
    )
    error = samples.panel_pixel - truth(samples.camera_pixel)
    beside = samples.camera_pixel[:, 0] > 90
    assert beside.sum() > 50
    assert np.abs(error[beside].mean(axis=0)).max() < 0.03
