"""Procedural objects by name: the sculpture, plain shapes, and the dot board.

To add one: write a function in this folder with a default for each argument (lengths end in `_m`, colours are linear
RGB), and give it a line here and in scenes/README.md.
"""

from collections.abc import Callable

import numpy as np

from wlr_render.numerics.arrays import FloatArray
from wlr_render.scene.scene import Mesh
from wlr_render.scene.shapes import construction, textures

_FLUTES = 7
_TWISTS = 9
_RIPPLES = 54
_TILES = (18, 3)  # repeats of the texture along and around the tube


def sculpture(height_m: float = 0.2, around: int = 96, along: int = 1200) -> Mesh:
    """Return a trefoil knot standing on two of its lobes, origin at the middle of its foot, facing +z.

    Args:
        height_m: overall height.
        around, along: quads around and along the tube; by default 230,400 triangles.
    """
    t, phi = np.meshgrid(np.linspace(0, 2 * np.pi, along + 1), np.linspace(0, 2 * np.pi, around + 1))
    relief = _relief(t, phi)
    position, normal = _surface(t, phi, relief)
    uv = np.stack([t, phi], axis=-1) / (2 * np.pi) * _TILES
    mesh = construction.from_grid("sculpture", position, normal, uv)
    low, high = mesh.position.min(axis=0), mesh.position.max(axis=0)
    foot = np.array([0.5 * (low[0] + high[0]), low[1], 0.5 * (low[2] + high[2])])
    scale = height_m / (high[1] - low[1])
    # The valleys between the flutes get less ambient light.
    shade = (0.4 + 0.6 * relief).reshape(-1, 1)
    return Mesh(
        "sculpture",
        ((mesh.position - foot) * scale).astype(np.float32),
        mesh.normal,
        mesh.triangles,
        uv=mesh.uv,
        texture=textures.inlay(),
        vertex_colour=np.repeat(shade, 3, axis=1).astype(np.float32),
    )


def _relief(t: FloatArray, phi: FloatArray) -> FloatArray:
    """Return the height of the skin's relief in 0..1: flutes that wind around the tube, crossed by ripples."""
    flutes = 0.5 + 0.5 * np.cos(_FLUTES * phi + _TWISTS * t)
    ripples = 0.5 + 0.5 * np.cos(_RIPPLES * t - 2 * phi)
    return np.asarray(0.8 * flutes + 0.2 * ripples)


def _centre_line(t: FloatArray) -> FloatArray:
    """Return the trefoil (2, 3) on a torus of radii 2 and 1, one lobe up, (..., 3)."""
    ring = 2 + np.cos(3 * t)
    return np.stack([-ring * np.sin(2 * t), ring * np.cos(2 * t), np.sin(3 * t)], axis=-1)


def _surface(t: FloatArray, phi: FloatArray, relief: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return positions and normals, (rows, columns, 3), before scaling."""
    step = 1e-5
    tangent = _centre_line(t + step) - _centre_line(t - step)
    tangent /= np.linalg.norm(tangent, axis=-1, keepdims=True)
    # The normal of the torus on which the knot lies closes after one turn, without a seam.
    outward = np.stack([-np.cos(3 * t) * np.sin(2 * t), np.cos(3 * t) * np.cos(2 * t), np.sin(3 * t)], axis=-1)
    sideways = np.cross(tangent, outward)
    radius = (0.5 + 0.17 * relief)[..., None]
    position = _centre_line(t) + radius * (np.cos(phi)[..., None] * outward + np.sin(phi)[..., None] * sideways)
    along = _periodic_difference(position, axis=1)
    around = _periodic_difference(position, axis=0)
    return position, np.cross(around, along)


def _periodic_difference(position: FloatArray, axis: int) -> FloatArray:
    """Return central differences on a grid whose last row or column repeats the first."""
    rolled = np.moveaxis(position, axis, 0)[:-1]
    difference = np.roll(rolled, -1, axis=0) - np.roll(rolled, 1, axis=0)
    return np.moveaxis(np.concatenate([difference, difference[:1]]), 0, axis)


SHAPES: dict[str, Callable[..., Mesh]] = {
    "ball": construction.ball,
    "box": construction.box,
    "dot_board": construction.dot_board,
    "plane": construction.plane,
    "sculpture": sculpture,
    "sphere": construction.sphere,
}
