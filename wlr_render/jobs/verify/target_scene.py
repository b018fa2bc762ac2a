"""The calibration target as a scene, and the dots that a panel can show completely."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from wlr_render.captures.targets.dot_board import DotBoard
from wlr_render.geometry import transforms
from wlr_render.mappings import EyeMappings
from wlr_render.numerics.arrays import FloatArray
from wlr_render.rendering.scene import Instance, Mesh, Scene
from wlr_render.rendering.shapes import construction
from wlr_render.rendering.srgb import encode_srgb

_TEXELS_PER_PITCH = 64
_LARGEST_TEXTURE_PX = 8192
_AROUND = 1.3  # of a dot's radius: some white has to be seen around it
_RING = 12
_EDGE_PX = 2.0  # panel pixels


def target_scene(board: DotBoard, world_from_target: FloatArray) -> Scene:
    """The board alone in the dark, evenly bright, at its pose (4, 4) in the world."""
    mesh_from_target = transforms.rigid(transforms.OPENXR_FROM_OPENCV, np.zeros(3))
    world_from_mesh = world_from_target @ transforms.inverse(mesh_from_target)
    ambient = np.ones(3, np.float32)
    return Scene("target", (_mesh(board),), (Instance("target", 0, world_from_mesh),), (), ambient)


def _mesh(board: DotBoard) -> Mesh:
    """A rectangle whose texture shows the board upright as seen from the front: x right, y up, facing +z."""
    width, height = board.size_m
    texel = max(board.pitch_m / _TEXELS_PER_PITCH, float(max(width, height)) / _LARGEST_TEXTURE_PX)
    columns, rows = (int(np.ceil(length / texel)) for length in (width, height))
    x = (np.arange(columns) + 0.5) / columns * width - 0.5 * width
    y = (np.arange(rows) + 0.5) / rows * height - 0.5 * height
    paint = board.reflectance(np.stack(np.meshgrid(x, y), axis=-1), texel)
    texture = encode_srgb(np.repeat(paint[..., None], 3, axis=-1).astype(np.float32))
    return replace(construction.rectangle("target", float(width), float(height)), texture=texture)


def wholly_shown(
    models: EyeMappings, board: DotBoard, device_from_target: FloatArray, viewpoint: FloatArray
) -> NDArray[np.bool_]:
    """(rows, columns) which dots lie on the panel with their surroundings: the panel's edge displaces the others.

    Args:
        models: of the eye.
        board: the target.
        device_from_target: (4, 4) where it is drawn.
        viewpoint: (3,) for which it is drawn.
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
