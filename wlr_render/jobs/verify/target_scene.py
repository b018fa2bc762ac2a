"""The calibration target as a scene, to be drawn where it stands."""

import numpy as np

from wlr_render.captures.targets.dot_board import DotBoard
from wlr_render.geometry import transforms
from wlr_render.numerics.arrays import FloatArray
from wlr_render.rendering.scene import Instance, Mesh, Scene
from wlr_render.rendering.shapes import construction
from wlr_render.rendering.srgb import encode_srgb

_TEXELS_PER_PITCH = 64
_LARGEST_TEXTURE_PX = 8192


def target_scene(board: DotBoard, world_from_target: FloatArray) -> Scene:
    """The board alone in the dark, evenly bright, at its pose (4, 4) in the world."""
    mesh_from_target = transforms.rigid(transforms.OPENXR_FROM_OPENCV, np.zeros(3))
    world_from_mesh = world_from_target @ transforms.inverse(mesh_from_target)
    ambient = np.ones(3, np.float32)
    return Scene("target", (_mesh(board),), (Instance("target", 0, world_from_mesh),), (), ambient)


def _mesh(board: DotBoard) -> Mesh:
    """A rectangle whose texture shows the board upright as seen from the front: x right, y up, facing +z."""
    from dataclasses import replace

    width, height = board.size_m
    texel = max(board.pitch_m / _TEXELS_PER_PITCH, float(max(width, height)) / _LARGEST_TEXTURE_PX)
    columns, rows = (int(np.ceil(length / texel)) for length in (width, height))
    x = (np.arange(columns) + 0.5) / columns * width - 0.5 * width
    y = (np.arange(rows) + 0.5) / rows * height - 0.5 * height
    paint = board.reflectance(np.stack(np.meshgrid(x, y), axis=-1), texel)
    texture = encode_srgb(np.repeat(paint[..., None], 3, axis=-1).astype(np.float32))
    return replace(construction.rectangle("target", float(width), float(height)), texture=texture)
