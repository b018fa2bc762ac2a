"""From rendered photographs with known truth to identified dots."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest
from captures.boards.board_pictures import BARREL, BOARD, CAMERA, exposed, light_of, pose, truth
from numpy import unsignedinteger
from numpy.typing import NDArray

from wlr_render.captures.boards.board import BoardNotFoundError, BoardObservation
from wlr_render.captures.boards.board_design import design_board
from wlr_render.lenses.lens_camera import LensCamera
from wlr_render.numerics.arrays import FloatArray

VIEW = pose(turn_deg=25, tilt_deg=20, distance_m=0.27)


@pytest.fixture(scope="module")
def light() -> FloatArray:
    """A view of the whole board, slanted."""
    return light_of(CAMERA, VIEW)


def rms(found: BoardObservation, camera: LensCamera, camera_from_board: FloatArray) -> float:
    return float(np.sqrt(np.mean((found.pixel - truth(camera, camera_from_board, found.index)) ** 2)))


def spotted(light: FloatArray, centres: FloatArray, radius: int, level: float) -> FloatArray:
    light = light.copy()
    for x, y in centres:
        cv2.circle(light, (int(x), int(y)), radius, level, -1)
    return light


@pytest.mark.parametrize("camera", [CAMERA, BARREL], ids=["pinhole", "barrel"])
@pytest.mark.parametrize(
    ("view", "least"),
    [
        ({"turn_deg": 37}, 245),
        ({"turn_deg": 100, "tilt_deg": 45, "distance_m": 0.3}, 252),
        ({"turn_deg": 190, "tilt_deg": 50, "distance_m": 0.2, "tilt_axis": "x"}, 180),
        ({"turn_deg": 290, "distance_m": 0.12, "shift_m": (0.02, 0.01)}, 80),
        ({"turn_deg": 10, "distance_m": 0.45}, 252),
    ],
    ids=["turned", "slanted", "near and slanted", "part of it", "far"],
)
def test_centres_of_clean_pictures(camera: LensCamera, view: dict[str, Any], least: int) -> None:
    camera_from_board = pose(**view)
    found = BOARD.find(exposed(light_of(camera, camera_from_board)))
    assert len(found) >= least
    assert rms(found, camera, camera_from_board) < 0.01


def test_without_the_correction_slanted_dots_would_be_off() -> None:
    """That the accuracy above is not an easy one: the bias of centres in that view is far larger."""
    camera_from_board = pose(turn_deg=190, tilt_deg=50, distance_m=0.2, tilt_axis="x")
    index = BOARD.indices()
    angle = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    rim = 0.5 * BOARD.large_m * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=-1)
    centre = BOARD.point_of(index)
    rims = CAMERA.pixel_of_point((centre[:, None] + rim) @ camera_from_board[:3, :3].T + camera_from_board[:3, 3])
    axes_mean = 0.5 * (rims.max(axis=1) + rims.min(axis=1))  # an ellipse's box is centred on it
    assert np.abs(axes_mean - truth(CAMERA, camera_from_board, index)).max() > 0.15


@pytest.mark.parametrize(
    ("white", "snr", "dtype"),
    [(200, 20, np.uint8), (12, 20, np.uint8), (2500, 20, np.uint16), (50_000, 20, np.uint16)],
    ids=["8 bits", "hardly exposed", "12 bits", "16 bits"],
)
def test_sigma_is_honest_at_any_exposure(light: FloatArray, white: int, snr: int, dtype: type[unsignedinteger]) -> None:
    found = BOARD.find(exposed(light, white, snr, dtype=dtype))
    assert len(found) == BOARD.large.size
    assert rms(found, CAMERA, VIEW) < 0.05
    pull = (found.pixel - truth(CAMERA, VIEW, found.index)) / found.sigma_px[:, None]
    assert np.sqrt(np.mean(pull**2)) == pytest.approx(1.0, abs=0.3)


def test_uneven_light_and_blur(light: FloatArray) -> None:
    v, u = np.mgrid[:400, :480]
    uneven = light * (0.15 + 0.85 * np.exp(-((u - 100) ** 2 + (v - 300) ** 2) / 250**2))
    found = BOARD.find(exposed(cv2.GaussianBlur(uneven, (0, 0), 1.2)))
    assert len(found) == BOARD.large.size
    assert rms(found, CAMERA, VIEW) < 0.02


@pytest.mark.parametrize(("surround", "dot", "veil"), [(0.0, 0.05, 0.0), (0.0, 0.5, 0.0), (0.6, 0.05, 0.5)])
def test_dark_surround_grey_dots_and_stray_light(surround: float, dot: float, veil: float) -> None:
    light = veil + (1 - veil) * light_of(CAMERA, VIEW, surround=surround, dot=dot)
    found = BOARD.find(exposed(light, snr=40))
    assert len(found) == BOARD.large.size
    assert rms(found, CAMERA, VIEW) < 0.05


def test_missing_dots_and_clutter(light: FloatArray) -> None:
    rng = np.random.default_rng(3)
    gone = rng.permutation(BOARD.indices())[:30]
    there = spotted(light, truth(CAMERA, VIEW, gone), 9, 1.0)
    cluttered = spotted(there, rng.uniform(0, [480, 400], (40, 2)), 4, 0.1)
    found = BOARD.find(exposed(cluttered, snr=20))
    assert len(found) > 160
    assert not {tuple(each) for each in gone} & {tuple(each) for each in found.index}
    assert rms(found, CAMERA, VIEW) < 0.1


def test_a_single_row_that_sticks_out_does_no_harm(light: FloatArray) -> None:
    index = BOARD.indices()
    column, row = index.T
    gone = index[((column > 6) & (row != 3)) | (row > 6)]
    image = exposed(spotted(light, truth(CAMERA, VIEW, gone), 9, 1.0))
    found = BOARD.find(image)
    assert len(found) >= 40
    assert rms(found, CAMERA, VIEW) < 0.1


def test_dots_of_the_wrong_size_are_left_out() -> None:
    wrong = np.random.default_rng(4).permutation(BOARD.indices())[:12]
    large = BOARD.large.copy()
    large[wrong[:, 1], wrong[:, 0]] ^= True
    found = BOARD.find(exposed(light_of(CAMERA, VIEW, replace(BOARD, large=large))))
    assert len(found) == BOARD.large.size - len(wrong)
    assert not {tuple(each) for each in wrong} & {tuple(each) for each in found.index}


def test_dots_strewn_about_are_no_board() -> None:
    strewn = np.random.default_rng(5).uniform(0, [480, 400], (300, 2))
    with pytest.raises(BoardNotFoundError):
        BOARD.find(exposed(spotted(np.ones((400, 480)), strewn, 4, 0.1)))


@pytest.mark.parametrize("mirrored", [lambda image: image[:, ::-1], lambda image: image[::-1], np.transpose])
def test_a_mirrored_picture_is_called_so(light: FloatArray, mirrored: Callable[..., Any]) -> None:
    with pytest.raises(BoardNotFoundError, match=r"^left\.png: the picture is mirrored"):
        BOARD.find(np.ascontiguousarray(mirrored(exposed(light))), "left.png")


def test_another_board_is_called_so(light: FloatArray) -> None:
    with pytest.raises(BoardNotFoundError, match=r"view 3: .* is it another board"):
        design_board(18, 14, 0.01, seed=2).find(exposed(light), "view 3")


def test_too_small_a_part_says_how_many_dots_it_has(light: FloatArray) -> None:
    part = np.full_like(light, 1.0)
    part[170:240, 200:270] = light[170:240, 200:270]
    with pytest.raises(BoardNotFoundError, match=r"photograph: only \d+ dots in one piece were seen; at least 20 are"):
        BOARD.find(exposed(part))


@pytest.mark.parametrize(
    ("picture", "sentence"),
    [
        (np.zeros((400, 480), np.uint8), "no board is in the picture.* from 0 to 0; expose it more"),
        (np.full((400, 480), 255, np.uint8), "most of the picture is at its brightest value, 255; expose it less"),
        (np.full((400, 480), 65535, np.uint16), "brightest value, 65535"),
        (np.random.default_rng(1).normal(100, 5, (400, 480)).astype(np.uint8), "no board is in the picture"),
        (np.zeros((9, 9), np.uint8), "no board is in the picture"),
    ],
    ids=["black", "white", "white of 16 bits", "noise", "tiny"],
)
def test_pictures_without_a_board_are_named(picture: NDArray[np.uint16] | NDArray[np.uint8], sentence: str) -> None:
    with pytest.raises(BoardNotFoundError, match=rf"^shot 7: .*{sentence}"):
        BOARD.find(picture, "shot 7")
