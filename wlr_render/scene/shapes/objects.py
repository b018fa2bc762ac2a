"""Procedural objects by name: the sculpture, things around a desk, and plain shapes.

To add one: write a function in this folder with a default for each argument (lengths end in `_m`, colours are linear
RGB), and give it a line here and in scenes/README.md.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from wlr_render.numerics.arrays import FloatArray
from wlr_render.scene.scene import Mesh
from wlr_render.scene.shapes import construction, textures
from wlr_render.scene.shapes.construction import Colour, coloured, cuboid, merged, moved, revolved, tube, turned

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
    # The normal of the torus that carries the knot closes after one round, without a seam.
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


def plinth(radius_m: float = 0.11, height_m: float = 0.1) -> Mesh:
    """Return a turned stone plinth, origin at the middle of its foot."""
    relative = [(0, 1), (0.9, 1), (0.95, 0.97), (0.95, 0.86), (0.82, 0.82), (0.78, 0.74), (0.78, 0.3), (0.84, 0.22)]
    relative += [(0.98, 0.18), (1, 0.14), (1, 0.02), (0.98, 0), (0, 0)]
    profile = np.array(relative) * [radius_m, height_m]
    stone = construction.revolved("plinth", profile, segments=96)
    x, y, z = stone.position.T
    flat = np.abs(stone.normal[:, 1]) > 0.7
    round_the_side = radius_m * np.arctan2(x, z)
    uv = np.stack([np.where(flat, x, round_the_side), np.where(flat, z, -y)], axis=-1) * 4
    return Mesh(
        "plinth", stone.position, stone.normal, stone.triangles, uv=uv.astype(np.float32), texture=textures.marble()
    )


_DARK: Colour = (0.02, 0.022, 0.026)
_METAL: Colour = (0.45, 0.46, 0.48)


def tabletop(size_m: Colour = (1.4, 0.03, 0.7)) -> Mesh:
    """Return a wooden slab of width, thickness, depth, origin at the middle of its top."""
    slab = moved(cuboid("tabletop", size_m), translation=(0, -size_m[1], 0))
    uv = np.stack([slab.position[:, 0], slab.position[:, 2] - slab.position[:, 1]], axis=-1) * 1.5
    return replace(slab, uv=uv.astype(np.float32), texture=textures.wood())


def mug(colour: Colour = (0.75, 0.12, 0.06)) -> Mesh:
    """Return a mug of coffee, 95 mm high, its handle to the right."""
    outer = [(0.034, 0.095), (0.0375, 0.095), (0.0375, 0.006), (0.034, 0), (0, 0)]
    inner = [(0, 0.078), (0.034, 0.078)]
    wall = [(0.034, 0.078), (0.034, 0.095)]
    angle = np.linspace(0.62 * np.pi, -0.62 * np.pi, 33)
    bow = np.stack([0.044 + 0.024 * np.cos(angle), 0.05 + 0.03 * np.sin(angle), np.zeros_like(angle)], axis=-1)
    parts = [
        coloured(revolved("", np.array(outer)), colour),
        coloured(revolved("", np.array(wall)[::-1]), (0.8, 0.78, 0.72)),
        coloured(revolved("", np.array(inner)), (0.05, 0.02, 0.008)),
        coloured(tube("", bow, 0.0055), colour),
    ]
    return merged("mug", parts)


def book(size_m: Colour = (0.24, 0.03, 0.17), colour: Colour = (0.05, 0.12, 0.3)) -> Mesh:
    """Return a closed book lying on its back, width, thickness, depth; its spine faces +z."""
    width, thick, deep = size_m
    board = 0.0025
    pages = moved(cuboid("", (width - 0.008, thick - 2 * board, deep - 0.006)), (0, board, -0.002))
    cover = cuboid("", (width, board, deep))
    spine = moved(cuboid("", (width, thick, board)), (0, 0, 0.5 * deep))
    title = moved(cuboid("", (0.45 * width, 0.35 * thick, 0.0008)), (-0.1 * width, 0.32 * thick, 0.5 * deep + board))
    bindings = [coloured(part, colour) for part in (cover, moved(cover, (0, thick - board, 0)), spine)]
    return merged("book", [*bindings, coloured(pages, (0.8, 0.76, 0.66)), coloured(title, (0.75, 0.6, 0.25))])


def monitor(width_m: float = 0.52) -> Mesh:
    """Return the body and foot of a flat monitor, 16:9; `monitor_screen` has its picture."""
    height = width_m * 9 / 16
    slab = moved(cuboid("", (width_m + 0.016, height + 0.016, 0.018)), (0, 0.112, -0.01))
    neck = moved(cuboid("", (0.06, 0.16, 0.02)), (0, 0.01, -0.035))
    foot = cuboid("", (0.24, 0.012, 0.17))
    return merged("monitor", [coloured(slab, _DARK), coloured(neck, _METAL), coloured(foot, _METAL)])


def monitor_screen(width_m: float = 0.52) -> Mesh:
    """Return the picture of a `monitor` of the same width at the same place."""
    height = width_m * 9 / 16
    panel = moved(construction.rectangle("monitor_screen", width_m, height), (0, 0.12 + 0.5 * height, 0))
    return replace(panel, texture=textures.screen())


def keyboard() -> Mesh:
    """Return a keyboard, 440 mm wide, its keys up."""
    size = (0.44, 0.016, 0.14)
    top = cuboid("", size, faces=("top",))
    sides = cuboid("", size, faces=("front", "back", "left", "right"))
    in_a_gap = np.full_like(top.uv, 0.99, shape=(len(sides.position), 2))
    return replace(merged("keyboard", [top, replace(sides, uv=in_a_gap)]), texture=textures.keys())


def lamp(colour: Colour = (0.8, 0.4, 0.08)) -> Mesh:
    """Return a jointed desk lamp, about 0.45 m high, its head over +x."""
    joints = np.array([[0, 0.02, 0], [-0.1, 0.24, 0], [0.1, 0.43, 0]])
    arms = [tube("", np.linspace(joints[i], joints[i + 1], 3), 0.006) for i in (0, 1)]
    knuckles = [moved(construction.globe("", 0.012, 24), joint) for joint in joints]
    base = revolved("", np.array([(0, 0.02), (0.075, 0.02), (0.08, 0.015), (0.08, 0), (0, 0)]))
    shade = np.array([(0, 0.07), (0.02, 0.068), (0.03, 0.05), (0.07, -0.02)])
    head = moved(turned(revolved("", shade, smooth=True), about_z=0.5), (0.12, 0.4, 0))
    bulb = moved(construction.globe("", 0.026, 24), (0.125, 0.392, 0))
    parts = [coloured(part, _METAL) for part in (*arms, *knuckles)]
    return merged("lamp", [*parts, coloured(base, colour), coloured(head, colour), coloured(bulb, (2.5, 2.3, 1.8))])


def plant(leaves: int = 26, height_m: float = 0.32) -> Mesh:
    """Return a pot of long, arching leaves."""
    rng = np.random.default_rng(4)
    pot = np.array([(0.0, 0.1), (0.062, 0.1), (0.062, 0.115), (0.072, 0.115), (0.072, 0.095), (0.066, 0.095)])
    pot = np.concatenate([pot, [(0.048, 0.0), (0.0, 0.0)]])
    parts = [coloured(revolved("", pot), (0.5, 0.18, 0.08))]
    for leaf in range(leaves):
        blade = _leaf(length=height_m * rng.uniform(0.7, 1.1), droop=rng.uniform(0.5, 1.9))
        green = (0.03 + 0.05 * rng.random(), 0.16 + 0.16 * rng.random(), 0.03)
        placed = turned(blade, about_y=2.4 * leaf + rng.uniform(-0.3, 0.3))
        parts.append(coloured(moved(placed, (0, 0.1, 0)), green))
    return merged("plant", parts)


def _leaf(length: float, droop: float) -> Mesh:
    """Return a blade that rises from the origin and rays over towards +z by `droop` radians."""
    along = np.linspace(0, 1, 15)
    angle = 0.15 + droop * along
    step = length / along.size
    z, y = np.cumsum(np.sin(angle)) * step, np.cumsum(np.cos(angle)) * step
    half_width = 0.011 * np.sin(np.pi * np.clip(0.12 + 0.88 * along, 0, 1)) ** 0.8 + 1e-4
    position = np.stack([np.stack([s * half_width, y, z], axis=-1) for s in (1.0, -1.0)], axis=1)
    normal = np.stack([np.zeros_like(y), -np.sin(angle), np.cos(angle)], axis=-1)
    return construction.from_grid("", position, np.repeat(normal[:, None], 2, axis=1))


def picture(width_m: float = 0.7) -> Mesh:
    """Return a painting, 0.7 times as high as wide, origin at its centre."""
    canvas = construction.rectangle("picture", width_m, 0.711 * width_m)
    return replace(canvas, texture=textures.painting())


SHAPES: dict[str, Callable[..., Mesh]] = {
    "ball": construction.ball,
    "book": book,
    "box": construction.box,
    "dot_board": construction.dot_board,
    "keyboard": keyboard,
    "lamp": lamp,
    "monitor": monitor,
    "monitor_screen": monitor_screen,
    "mug": mug,
    "picture": picture,
    "plane": construction.plane,
    "plant": plant,
    "plinth": plinth,
    "sculpture": sculpture,
    "sphere": construction.sphere,
    "tabletop": tabletop,
}
