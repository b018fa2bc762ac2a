"""Every kind of board, rendered through a lens with perspective, blur, uneven light and noise, against the truth.

The pictures have what the detectors' models lack: shot noise that grows with the light, vignetting, stray light, barrel
distortion, and rounding to 8 bits.
"""

from functools import cache

import cv2
import numpy as np
import pytest
from captures.boards.board_pictures import BARREL, light_of, pose, truth
from numpy.typing import NDArray

from wlr_render.captures.boards.april_grid import AprilGrid
from wlr_render.captures.boards.board import Board, BoardNotFoundError, BoardObservation
from wlr_render.captures.boards.board_design import design_board
from wlr_render.captures.boards.charuco import CharucoBoard
from wlr_render.captures.boards.chessboard import Chessboard
from wlr_render.captures.boards.circle_grid import CircleGrid
from wlr_render.numerics.arrays import FloatArray

BOARDS = {
    "dots": design_board(16, 12, 0.01),
    "charuco": CharucoBoard(8, 6, 0.02, 0.015, "DICT_4X4_100", margin_m=0.005),
    "charuco legacy": CharucoBoard(8, 6, 0.02, 0.015, "DICT_4X4_100", legacy=True, margin_m=0.005),
    "april-grid": AprilGrid(3, 2, 0.045, 0.3, margin_m=0.005),
    "chessboard": Chessboard(8, 5, 0.016, 0.016),
    "chessboard, half-turn symmetric": Chessboard(7, 5, 0.018, 0.018),
    "circles": CircleGrid(9, 7, 0.016, 0.009, 0.016),
    "asymmetric circles": CircleGrid(4, 11, 0.012, 0.01, 0.016, staggered=True),
}
VIEW = pose(turn_deg=12, tilt_deg=28, distance_m=0.27, tilt_axis="x")


@cache
def sharp_light(name: str) -> FloatArray:
    return light_of(BARREL, VIEW, BOARDS[name])


@cache
def view(name: str, blur_px: float = 0.8) -> FloatArray:
    light = sharp_light(name)
    height, width = light.shape
    v, u = np.mgrid[:height, :width]
    lamp = 0.35 + 0.65 * np.exp(-((u - 0.3 * width) ** 2 + (v - 0.7 * height) ** 2) / (0.6 * width) ** 2)
    vignette = (1 + ((u - width / 2) ** 2 + (v - height / 2) ** 2) / width**2) ** -2
    return np.asarray(0.04 + cv2.GaussianBlur(light, (0, 0), blur_px) * lamp * vignette)


def photograph(name: str, seed: int, blur_px: float = 0.8) -> NDArray[np.uint8]:
    """8 bits with shot noise of 4000 electrons at white and read-out noise."""
    rng, light = np.random.default_rng(seed), view(name, blur_px)
    electrons = rng.poisson(4000 * light) + rng.normal(0, 15, light.shape)
    return np.clip(np.rint(electrons * (220 / 4000)), 0, 255).astype(np.uint8)


def unturned(found: BoardObservation, board: Board) -> BoardObservation:
    """The numbering of a half-turn symmetric board that fits the view."""
    assert found.ambiguous_half_turn == board.half_turn_symmetric
    off = [np.median(np.abs(each.pixel - truth(BARREL, VIEW, each.index, board))) for each in both(found, board)]
    return both(found, board)[int(np.argmin(off))]


def both(found: BoardObservation, board: Board) -> list[BoardObservation]:
    return [found, found.half_turned(board)] if found.ambiguous_half_turn else [found]


@pytest.mark.slow
@pytest.mark.parametrize("name", BOARDS)
def test_features_are_where_they_are_and_sigma_is_honest(name: str) -> None:
    board, pulls, errors, seen = BOARDS[name], [], [], 0
    for seed in range(8):
        found = unturned(board.find(photograph(name, seed)), board)
        error = found.pixel - truth(BARREL, VIEW, found.index, board)
        errors.append(error.ravel())
        pulls.append((error / found.sigma_px[:, None]).ravel())
        seen += len(found)
    assert seen >= 0.97 * 8 * len(board.indices())
    assert np.abs(np.concatenate(errors)).max() < 0.25
    assert np.sqrt(np.mean(np.concatenate(errors) ** 2)) < 0.05
    assert 0.8 < np.sqrt(np.mean(np.concatenate(pulls) ** 2)) < 1.3


@pytest.mark.slow
@pytest.mark.parametrize("name", BOARDS)
def test_out_of_focus_sigma_grows_and_stays_honest(name: str) -> None:
    board = BOARDS[name]
    sharp = board.find(photograph(name, 1))
    found = [unturned(board.find(photograph(name, seed, 1.5)), board) for seed in range(4)]
    pulls = [(each.pixel - truth(BARREL, VIEW, each.index, board)) / each.sigma_px[:, None] for each in found]
    assert 0.75 < np.sqrt(np.mean(np.concatenate(pulls) ** 2)) < 1.35
    assert np.median(found[0].sigma_px) > 1.1 * np.median(sharp.sigma_px)


@pytest.mark.parametrize("name", BOARDS)
def test_a_mirrored_picture_is_never_numbered_as_if_it_were_not(name: str) -> None:
    """Kinds that look the same mirrored are found with right-handed numbers; the others are refused."""
    board, image = BOARDS[name], np.ascontiguousarray(photograph(name, 1)[:, ::-1])
    try:
        found = board.find(image)
    except BoardNotFoundError:
        return
    point = board.point_of(found.index)[:, :2]
    design = np.concatenate([point, np.ones((len(point), 1))], axis=1)
    slope = np.linalg.lstsq(design, found.pixel, rcond=None)[0][:2]
    assert np.linalg.det(slope) > 0
    assert name in ("chessboard", "chessboard, half-turn symmetric", "circles", "asymmetric circles")


@pytest.mark.parametrize("name", BOARDS)
def test_places_and_picture_of_a_board_agree_about_its_frame(name: str) -> None:
    board = BOARDS[name]
    point = board.point_of(board.indices())
    assert np.allclose(point.min(axis=0), -point.max(axis=0), atol=1e-12)
    assert (np.abs(point[:, :2]) < 0.5 * board.size_m).all()
    beyond = np.array([[0.51 * board.size_m[0], 0.0], [0.0, -0.51 * board.size_m[1]]])
    assert np.isnan(board.reflectance(beyond)).all()
    step = 0.25 * board.finest_m if "circles" not in name and name != "dots" else 0.1 * board.finest_m
    around = point[:, None, :2] + step * np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]])
    near = board.reflectance(around)
    if name in ("dots", "circles", "asymmetric circles"):
        assert (near == 0).all(), "the middle of a dot is black"
    else:
        assert (near[:, 0] == near[:, 2]).all()
        assert (near[:, 1] == near[:, 3]).all()
        assert (near[:, 0] != near[:, 1]).all(), "a corner has black and white in turn"
    size = board.size_m
    grid = np.stack(np.meshgrid(*(np.linspace(-0.499, 0.499, 301) * side for side in size)), axis=-1)
    sharp, soft = board.reflectance(grid), board.reflectance(grid, 0.002)
    assert set(np.unique(sharp)) == {0.0, 1.0}
    assert np.mean(soft) == pytest.approx(np.mean(sharp), abs=0.01)
    changed = np.mean(sharp != sharp[::-1, ::-1])
    assert changed < 0.01 if board.half_turn_symmetric else changed > 0.02
