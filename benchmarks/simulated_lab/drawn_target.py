"""The drawn target: a scene of the board alone, and the dots that the panel can show whole."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from wlr_render.calibration.bench.board_shape import BoardShape
from wlr_render.captures.boards.dot_board import DotBoard
from wlr_render.geometry import transforms
from wlr_render.mappings import Eye
from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.srgb import encode_srgb
from wlr_render.scene.scene import Instance, Mesh, Scene
from wlr_render.scene.shapes import construction

_TEXELS_PER_PITCH = 64
_LARGEST_TEXTURE_PX = 8192
_AROUND = 1.3  # radius of the white surroundings of a dot over the dot's radius
_RING = 12
_EDGE_PX = 2.0  # smallest distance from the panel's edge, panel pixels


def target_scene(board: DotBoard, shape: BoardShape | None, world_from_target: FloatArray) -> Scene:
    """Return a scene of the board alone in the dark, evenly bright.

    Args:
        board: the target.
        shape: shape of the board by calibration; None for a flat and exact board.
        world_from_target: (4, 4) pose of the board.
    """
    mesh_from_target = transforms.rigid(transforms.OPENXR_FROM_OPENCV, np.zeros(3))
    world_from_mesh = world_from_target @ transforms.inverse(mesh_from_target)
    ambient = np.ones(3, np.float32)
    return Scene("target", (_mesh(board, shape),), (Instance("target", 0, world_from_mesh),), (), ambient)


def _mesh(board: DotBoard, shape: BoardShape | None) -> Mesh:
    """Return the upright board: x right, y up, facing +z. Its vertices are the dots' centres and the edge."""
    width, height = board.size_m
    texel = max(board.pitch_m / _TEXELS_PER_PITCH, float(max(width, height)) / _LARGEST_TEXTURE_PX)
    columns, rows = (int(np.ceil(length / texel)) for length in (width, height))
    x = (np.arange(columns) + 0.5) / columns * width - 0.5 * width
    y = (np.arange(rows) + 0.5) / rows * height - 0.5 * height
    paint = board.reflectance(np.stack(np.meshgrid(x, y), axis=-1), texel)
    texture = encode_srgb(np.repeat(paint[..., None], 3, axis=-1).astype(np.float32))
    column, row = (np.clip(np.arange(-1, count + 1), 0, count - 1) for count in (board.columns, board.rows))
    index = np.stack(np.meshgrid(column, row), axis=-1)
    nominal = board.point_of(index)
    nominal[:, [0, -1], 0] = 0.5 * width * np.array([-1.0, 1.0])
    nominal[[0, -1], :, 1] = 0.5 * height * np.array([[-1.0], [1.0]])
    point = nominal
    if shape is not None:
        point = shape.point_of(index.reshape(-1, 2), nominal.reshape(-1, 3)).reshape(nominal.shape)
    position = point @ transforms.OPENXR_FROM_OPENCV.T
    mesh = construction.from_grid("target", position, np.broadcast_to([0.0, 0.0, 1.0], position.shape))
    uv = nominal[..., :2] / board.size_m + 0.5
    return replace(mesh, uv=uv.reshape(-1, 2).astype(np.float32), texture=texture)


def wholly_shown(
    models: Eye, board: DotBoard, device_from_target: FloatArray, viewpoint: FloatArray
) -> NDArray[np.bool_]:
    """Return a mask (rows, columns) of the dots that lie on the panel with their surroundings.

    Other dots would be cut off at the panel's edge, which displaces them.

    Args:
        models: models of the eye.
        board: the target.
        device_from_target: (4, 4) pose of the drawn board.
        viewpoint: (3,) viewpoint for which it is drawn.
    """
    index = board.indices()
    angle = np.linspace(0.0, 2.0 * np.pi, _RING, endpoint=False)
    ring = np.stack([np.cos(angle), np.sin(angle), np.zeros(_RING)], axis=-1)
    radius = 0.5 * _AROUND * board.diameter_of(index)
    point = transforms.apply(device_from_target, board.point_of(index)[:, None] + radius[:, None, None] * ring)
    seen = models.see_through.view_dir_of_real_point(point, viewpoint)
    shown = models.display.pixel_of_view_dir(seen.value, viewpoint)
    with np.errstate(invalid="ignore"):
        inside = (shown.value > _EDGE_PX) & (shown.value < models.display.panel.size_px - _EDGE_PX)
    whole = np.all(inside & (seen.usable & shown.usable)[..., None], axis=(1, 2))
    return np.asarray(whole.reshape(board.rows, board.columns))
