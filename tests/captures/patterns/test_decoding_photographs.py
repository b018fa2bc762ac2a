"""Decoding what a camera sees: injected truth, everything that spoils photographs."""

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pytest

from wlr_render.captures.decoded import Decoded, DecodeOptions, Rejection
from wlr_render.captures.patterns.catalogue import PATTERNS, make_pattern
from wlr_render.captures.patterns.pattern import Pattern
from wlr_render.mappings import Panel

if TYPE_CHECKING:
    from captures.patterns.conftest import ToyCamera

PANEL = Panel(221, 175)
SNR_20 = {"black": 20.0, "white": 180.0, "noise": 8.0}
FAMILIES = pytest.mark.parametrize("name", PATTERNS)


def decode(camera: "ToyCamera", name: str, **numbers: Any) -> Decoded:
    pattern = make_pattern(name, camera.panel, **numbers)
    return pattern.decode(camera.photographs(pattern))


@FAMILIES
@pytest.mark.parametrize(("scale", "turn"), [(1.0, 0.3), (1.5, 0.02), (1.5, -1.4), (2.0, 0.1)])
def test_a_tenth_of_a_panel_pixel_at_snr_20(
    toy_camera: Callable[..., Any],
    errors_of: Callable[[Any, Decoded], tuple[Any, Any]],
    name: str,
    scale: float,
    turn: float,
) -> None:
    camera = toy_camera(PANEL, scale=scale, turn=turn, **SNR_20)
    errors, share = errors_of(camera, decode(camera, name))
    assert np.sqrt(np.mean(errors**2)) <= 0.1
    assert np.mean(errors > 1) <= 1e-4
    assert share > 0.999


@FAMILIES
@pytest.mark.parametrize("noise", [4.0, 8.0, 14.0])
def test_the_claimed_error_is_the_actual_one(toy_camera: Callable[..., Any], name: str, noise: float) -> None:
    camera = toy_camera(PANEL, **{**SNR_20, "noise": noise})
    result = decode(camera, name)
    inner = result.accepted & camera.whole()
    ratio = (result.pixel - camera.truth())[inner] / result.sigma_px[inner][:, None]
    assert 0.7 <= np.sqrt(np.mean(ratio**2)) <= 1.3


@FAMILIES
@pytest.mark.parametrize("gammas", [(2.2, 1.0), (1.0, 2.2), (2.2, 2.2)])
def test_gamma_of_panel_and_camera(
    toy_camera: Callable[..., Any],
    errors_of: Callable[[Any, Decoded], tuple[Any, Any]],
    name: str,
    gammas: tuple[float, float],
) -> None:
    camera = toy_camera(PANEL, panel_gamma=gammas[0], camera_gamma=gammas[1], **SNR_20)
    errors, share = errors_of(camera, decode(camera, name))
    assert np.sqrt(np.mean(errors**2)) <= 0.1
    assert np.mean(errors > 1) <= 1e-4
    assert share > 0.999


@FAMILIES
def test_ambient_light_and_vignetting(
    toy_camera: Callable[..., Any], errors_of: Callable[[Any, Decoded], tuple[Any, Any]], name: str
) -> None:
    x, y = np.meshgrid(np.linspace(-1, 1, 160), np.linspace(-1, 1, 128))
    ambient = 40 + 35 * x + 15 * np.sin(9 * y)
    camera = toy_camera(PANEL, black=ambient, white=ambient + 130 * (1 - 0.35 * (x**2 + y**2)), noise=3.0)
    errors, share = errors_of(camera, decode(camera, name))
    assert np.sqrt(np.mean(errors**2)) <= 0.1
    assert errors.max() < 1
    assert share > 0.999


@FAMILIES
def test_pixels_at_the_end_of_the_scale_are_rejected_as_such(
    toy_camera: Callable[..., Any], errors_of: Callable[[Any, Decoded], tuple[Any, Any]], name: str
) -> None:
    x = np.linspace(0, 1, 160) + np.zeros((128, 1))
    camera = toy_camera(PANEL, black=20.0, white=100 + 250 * x, noise=2.0)
    result = decode(camera, name)
    blown = camera.whole() & (camera.white > 262)
    assert (result.rejection[blown] == Rejection.SATURATED).all()
    errors, _ = errors_of(camera, result)
    assert result.accepted[camera.whole() & (camera.white < 240)].all()
    assert errors.max() < 1


@FAMILIES
def test_dark_surroundings_are_no_panel(toy_camera: Callable[..., Any], name: str) -> None:
    camera = toy_camera(Panel(97, 70), **SNR_20)
    result = decode(camera, name)
    outside = np.any((camera.truth() < -1.5) | (camera.truth() > camera.panel.size_px + 1.5), axis=-1)
    assert (result.rejection[outside] == Rejection.DARK).all()
    assert np.isnan(result.pixel[outside]).all()
    assert np.isnan(result.sigma_px[outside]).all()


def test_blur_over_many_panel_pixels_leaves_fringes_and_coarser_cells_of_a_gray_code(
    toy_camera: Callable[..., Any],
) -> None:
    camera = toy_camera(PANEL, black=20.0, white=180.0)
    rng = np.random.default_rng(1)

    def photographs(pattern: Pattern) -> Iterator[Any]:
        for image in camera.photographs(pattern):
            blurred = cv2.GaussianBlur(image.astype(float), (0, 0), 2.0)
            yield np.clip(np.round(blurred + rng.normal(0, 2, image.shape)), 0, 255).astype(np.uint8)

    pattern = make_pattern("gray-fringes", PANEL)
    result = pattern.decode(photographs(pattern))
    inner = result.accepted & cv2.erode(camera.whole().astype(np.uint8), np.ones((13, 13))).astype(bool)
    assert np.mean(inner) > 0.6
    assert np.abs(result.pixel - camera.truth())[inner].max() < 0.5
    gray = make_pattern("gray", PANEL)
    coarse = gray.decode(photographs(gray))
    inner &= coarse.accepted
    assert np.mean(inner) > 0.6
    assert coarse.cell_px[inner].min() == 4
    off = (coarse.pixel - camera.truth())[inner]
    assert np.abs(off).max() < 0.6
    assert np.sqrt(np.mean((off / coarse.sigma_px[inner][:, None]) ** 2)) < 1  # indirect light may add as much


@pytest.mark.parametrize("name", ["gray", "gray-fringes"])
@pytest.mark.parametrize("rate", [0.0005, 0.003])
def test_flipped_bits_are_rejected_or_harmless(
    toy_camera: Callable[..., Any], errors_of: Callable[[Any, Decoded], tuple[Any, Any]], name: str, rate: float
) -> None:
    camera = toy_camera(PANEL, black=20.0, white=180.0, noise=2.0)
    pattern = make_pattern(name, PANEL)
    shown = list(camera.photographs(pattern))
    rng = np.random.default_rng(7)
    for index, label in enumerate(pattern.names()):
        if label.endswith("inverse"):
            flipped = rng.random(shown[0].shape) < rate
            positive, inverse = shown[index - 1], shown[index]
            positive[flipped], inverse[flipped] = inverse[flipped], positive[flipped]
    result = pattern.decode(shown)
    errors, share = errors_of(camera, result)
    assert np.mean(errors > 1) <= 1e-4
    assert share > 1 - 4 * rate * len(shown)
    assert np.any(result.rejection == Rejection.ISOLATED)


def test_more_bits_than_eight_and_a_stated_full_scale(toy_camera: Callable[..., Any]) -> None:
    camera = toy_camera(PANEL, black=20.0, white=180.0)
    pattern = make_pattern("gray-fringes", PANEL)
    shown = [image.astype(np.uint16) * 16 for image in camera.photographs(pattern)]
    deep = pattern.decode(shown, DecodeOptions(full_scale=4095))
    plain = pattern.decode(image // 16 for image in shown)
    both = deep.accepted & plain.accepted
    assert both[camera.whole()].all()
    np.testing.assert_allclose(deep.pixel[both], plain.pixel[both], atol=1e-3)


def test_confidence_is_a_part_of_full_contrast(toy_camera: Callable[..., Any]) -> None:
    camera = toy_camera(PANEL, black=20.0, white=180.0)
    result = decode(camera, "gray-fringes")
    inner = result.confidence[camera.whole()]
    assert inner.max() <= 1
    assert np.median(inner) > 0.9
    assert (result.confidence[result.rejection == Rejection.DARK] < 1).all()
