"""Pictures of a board by a plain camera, some rays a pixel, with the truth of where its dots are seen."""

from functools import cache
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from wlr_render.captures.boards.board import Board
from wlr_render.captures.boards.board_design import design_board
from wlr_render.geometry.transforms import apply, rigid, rotation_about
from wlr_render.lenses.lens_camera import LensCamera
from wlr_render.numerics.arrays import FloatArray, IntArray

BOARD = design_board(18, 14, 0.01)
CAMERA = LensCamera((480, 400), np.array([520.0, 520.0]), np.array([243.0, 196.0]))
BARREL = LensCamera((480, 400), np.array([520.0, 520.0]), np.array([243.0, 196.0]), np.array([-0.2, 0, 0, 0, 0.0]))


def pose(
    turn_deg: float = 0.0,
    tilt_deg: float = 0.0,
    distance_m: float = 0.26,
    shift_m: tuple[float, float] = (0.0, 0.0),
    tilt_axis: str = "y",
) -> FloatArray:
    """camera_from_board: tilted about an axis of the picture, then looked at from a distance."""
    turn = rotation_about("z", np.deg2rad(turn_deg))
    tilt = rotation_about(tilt_axis, np.deg2rad(tilt_deg))
    return rigid(tilt @ turn, np.array([*shift_m, distance_m]))


@cache
def _ray_tangents(camera: LensCamera, rays: int) -> FloatArray:
    """(h * rays, w * rays, 2), from the pixels' corners."""
    width, height = camera.size_px
    within = (np.arange(rays) + 0.5) / rays
    corner = camera.tangents_of_pixel(np.stack(np.meshgrid(np.arange(width + 1.0), np.arange(height + 1.0)), axis=-1))
    down = (corner[:-1, None] * (1 - within[:, None, None]) + corner[1:, None] * within[:, None, None]).reshape(
        -1, width + 1, 2
    )
    return (down[:, :-1, None] * (1 - within[:, None]) + down[:, 1:, None] * within[:, None]).reshape(len(down), -1, 2)


def light_of(
    camera: LensCamera,
    camera_from_board: FloatArray,
    board: Board = BOARD,
    surround: float = 0.3,
    dot: float = 0.05,
    rays: int = 4,
) -> FloatArray:
    """(h, w) light: white of the board is 1, dots are `dot`, everything else `surround`.

    With two `rays` a pixel and axis, features are where they should be to a twentieth of a pixel.
    """
    rotation, origin = camera_from_board[:3, :3], camera_from_board[:3, 3]
    in_board, start = _ray_tangents(camera, rays) @ rotation[:2] + rotation[2], -origin @ rotation
    place = start[:2] - in_board[..., :2] * (start[2] / in_board[..., 2:])
    softness = np.full(place.shape[:-1], origin[2] / (rays * camera.focal_px[0]))
    reflectance = board.reflectance(place, softness)
    light = np.where(np.isnan(reflectance), surround, dot + (1 - dot) * reflectance)
    height, width = camera.size_px[::-1]
    return np.asarray(light.reshape(height, rays, width, rays).mean(axis=(1, 3)))


def truth(camera: LensCamera, camera_from_board: FloatArray, index: IntArray, board: Board = BOARD) -> FloatArray:
    """(n, 2) pixels where the dots' centres are seen."""
    return camera.pixel_of_point(apply(camera_from_board, board.point_of(index)))


@overload
def exposed(light: FloatArray, white: float = ..., snr: int | None = ..., seed: int = ...) -> NDArray[np.uint8]: ...
@overload
def exposed(
    light: FloatArray,
    white: float = ...,
    snr: int | None = ...,
    seed: int = ...,
    *,
    dtype: type[np.unsignedinteger[Any]],
) -> NDArray[np.uint16] | NDArray[np.uint8]: ...
def exposed(
    light: FloatArray,
    white: float = 200.0,
    snr: int | None = None,
    seed: int = 1,
    dtype: type[np.unsignedinteger[Any]] = np.uint8,
) -> NDArray[np.uint16] | NDArray[np.uint8]:
    """The picture that a camera makes: `white` grey values for 1, noise of white / snr."""
    noise = 0.0 if snr is None else np.random.default_rng(seed).normal(0, white / snr, light.shape)
    return np.clip(np.rint(light * white + noise), 0, np.iinfo(dtype).max).astype(dtype)
