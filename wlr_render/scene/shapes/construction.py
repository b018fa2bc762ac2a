"""Procedural meshes: grids of points, revolved profiles, tubes, boxes, plain shapes in one colour, and the dot board.

Triangles run counter-clockwise seen from outside, normals point outwards, metres. A texture's uv is (0, 0) at its
top-left corner.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from wlr_render.errors import BadInputError
from wlr_render.geometry import transforms
from wlr_render.numerics.arrays import FloatArray
from wlr_render.scene.scene import Mesh
from wlr_render.scene.shapes import textures

Colour = tuple[float, float, float]


def from_grid(name: str, position: FloatArray, normal: FloatArray, uv: FloatArray | None = None) -> Mesh:
    """Return a grid of points as a mesh, its outside where the columns run right and the rows run down.

    Args:
        name: name for messages.
        position, normal: (rows, columns, 3); normals are scaled to unit length here.
        uv: (rows, columns, 2), by default 0..1 over the grid.
    """
    rows, columns = position.shape[:2]
    if uv is None:
        uv = np.stack(np.meshgrid(np.linspace(0, 1, columns), np.linspace(0, 1, rows)), axis=-1)
    index = np.arange(rows * columns, dtype=np.uint32).reshape(rows, columns)
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    quads = np.stack([np.stack([a, b, c], axis=-1), np.stack([a, c, d], axis=-1)], axis=2)
    return _mesh(name, position.reshape(-1, 3), normal.reshape(-1, 3), quads.reshape(-1, 3), uv.reshape(-1, 2))


def _mesh(name: str, position: FloatArray, normal: FloatArray, triangles: NDArray[np.uint32], uv: FloatArray) -> Mesh:
    """Assemble a mesh; triangles that are degenerate at a pole of the grid are dropped."""
    corners = position[triangles]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    unit = normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    kept = triangles[area > 1e-14]
    return Mesh(name, position.astype(np.float32), unit.astype(np.float32), kept, uv=uv.astype(np.float32))


def revolved(name: str, profile: FloatArray, segments: int = 64, smooth: bool = False) -> Mesh:
    """Return the surface of revolution of a profile about the y axis.

    Args:
        name: name for messages.
        profile: (n, 2) radius and height, listed from the top down on the outside, so that the outside is to its left.
        segments: number of segments around the axis.
        smooth: True for one rounded surface; otherwise the shading has an edge at each point of the profile.
    """
    if not smooth:
        stretches = [revolved(name, profile[i : i + 2], segments, smooth=True) for i in range(len(profile) - 1)]
        return merged(name, stretches)
    angle = np.linspace(0, 2 * np.pi, segments + 1)
    ring = np.stack([np.sin(angle), np.zeros_like(angle), np.cos(angle)], axis=-1)
    up = np.array([0.0, 1.0, 0.0])
    position = profile[:, None, :1] * ring + profile[:, None, 1:] * up
    slope = np.gradient(profile, axis=0)
    normal = -slope[:, None, 1:] * ring + slope[:, None, :1] * up
    return from_grid(name, position, normal)


def tube(name: str, path: FloatArray, radius: float, segments: int = 16) -> Mesh:
    """Return a round tube along an open path (n, 3) in a plane z = constant."""
    tangent = np.gradient(path, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    out = np.array([0.0, 0.0, 1.0])
    side = np.cross(tangent, out)
    angle = np.linspace(0, 2 * np.pi, segments + 1)[:, None, None]
    normal = np.cos(angle) * side - np.sin(angle) * out
    return from_grid(name, path + radius * normal, normal)


def rectangle(name: str, width: float, height: float) -> Mesh:
    """Return a rectangle facing +z, centred at the origin, texture upright."""
    x, y = 0.5 * width, 0.5 * height
    position = np.array([[[-x, y, 0], [x, y, 0]], [[-x, -y, 0], [x, -y, 0]]])
    return from_grid(name, position, np.broadcast_to([0.0, 0.0, 1.0], position.shape))


_FACES = {"front": (0, 0), "back": (0, 180), "right": (0, 90), "left": (0, -90), "top": (-90, 0), "bottom": (90, 0)}


def cuboid(name: str, size: Sequence[float], faces: Sequence[str] = tuple(_FACES)) -> Mesh:
    """Return a box with its origin in the middle of its bottom; each face carries the whole texture, upright.

    Args:
        name: name for messages.
        size: width (x), height (y), depth (z).
        faces: which of "front" (+z), "back", "right" (+x), "left", "top", "bottom" to make.
    """
    extent = dict(zip("xyz", size, strict=True))
    parts = []
    for face in faces:
        about_x, about_y = np.deg2rad(_FACES[face])
        flat, tall, out = "xzy" if about_x else "zyx" if face in ("left", "right") else "xyz"
        panel = rectangle(name, extent[flat], extent[tall])
        outward = moved(panel, translation=(0, 0, 0.5 * extent[out]))
        parts.append(moved(turned(outward, about_x, about_y), translation=(0, 0.5 * extent["y"], 0)))
    return merged(name, parts)


def moved(mesh: Mesh, translation: Sequence[float]) -> Mesh:
    """Return the mesh, shifted."""
    return replace(mesh, position=(mesh.position + np.asarray(translation)).astype(np.float32))


def turned(mesh: Mesh, about_x: float = 0.0, about_y: float = 0.0, about_z: float = 0.0) -> Mesh:
    """Return the mesh, turned by angles in radians about z, then x, then y."""
    rotation = turn(about_x, about_y, about_z)
    position, normal = mesh.position @ rotation.T, mesh.normal @ rotation.T
    return replace(mesh, position=position.astype(np.float32), normal=normal.astype(np.float32))


def coloured(mesh: Mesh, colour: Colour) -> Mesh:
    """Return the mesh with one linear RGB colour at all its vertices, so that it can be merged with others."""
    return replace(mesh, vertex_colour=np.tile(np.array(colour, np.float32), (len(mesh.position), 1)))


def merged(name: str, parts: Sequence[Mesh]) -> Mesh:
    """Merge meshes into one with the material of the first; either all or none have vertex colours."""
    starts = np.cumsum([0] + [len(part.position) for part in parts[:-1]])
    shifted = [part.triangles + start for part, start in zip(parts, starts, strict=True)]
    colours = [part.vertex_colour for part in parts if part.vertex_colour is not None]
    return replace(
        parts[0],
        name=name,
        position=np.concatenate([part.position for part in parts]),
        normal=np.concatenate([part.normal for part in parts]),
        triangles=np.concatenate(shifted).astype(np.uint32),
        uv=np.concatenate([part.uv for part in parts if part.uv is not None]),
        vertex_colour=np.concatenate(colours) if colours else None,
    )


def turn(about_x: float, about_y: float, about_z: float) -> FloatArray:
    """Return the rotation (3, 3) by angles in radians about the fixed axes z, then x, then y: roll, pitch, yaw."""
    about = transforms.rotation_about
    return about("y", about_y) @ about("x", about_x) @ about("z", about_z)


_TEXELS_PER_PITCH = 40
_MOST_DOTS = 10_000


def plane(width_m: float = 1.0, height_m: float = 1.0, colour: Colour = (0.7, 0.7, 0.7)) -> Mesh:
    """Return a rectangle facing +z, origin at its centre."""
    return replace(rectangle("plane", width_m, height_m), base_colour=np.array(colour, np.float32))


def box(size_m: Colour = (0.1, 0.1, 0.1), colour: Colour = (0.7, 0.7, 0.7)) -> Mesh:
    """Return a box of width, height, depth, origin at the middle of its bottom."""
    return replace(cuboid("box", size_m), base_colour=np.array(colour, np.float32))


def sphere(radius_m: float = 0.05, colour: Colour = (0.7, 0.7, 0.7), segments: int = 64) -> Mesh:
    """Return a sphere, origin at its centre."""
    return replace(globe("sphere", radius_m, segments), base_colour=np.array(colour, np.float32))


def ball(radius_m: float = 0.06) -> Mesh:
    """Return a beach ball, origin at its centre."""
    skin = textures.stripes(("e4572e", "fdf6e3", "2e86ab", "fdf6e3", "f3a712", "fdf6e3"))
    return replace(globe("ball", radius_m, 64), texture=skin)


def globe(name: str, radius: float, segments: int) -> Mesh:
    """Return a sphere about the origin, the top row of its texture at +y."""
    latitude = np.linspace(0.5 * np.pi, -0.5 * np.pi, segments // 2 + 1)
    longitude = np.linspace(0, 2 * np.pi, segments + 1)
    x = np.cos(latitude)[:, None] * np.sin(longitude)
    y = np.repeat(np.sin(latitude)[:, None], segments + 1, axis=1)
    z = np.cos(latitude)[:, None] * np.cos(longitude)
    normal = np.stack([x, y, z], axis=-1)
    return from_grid(name, radius * normal, normal)


def dot_board(
    columns: int = 25,
    rows: int = 19,
    pitch_m: float = 0.02,
    diameter_m: float = 0.008,
    marker_diameter_m: float = 0.0,
) -> Mesh:
    """Return a white board of black round dots facing +z, origin at its centre, with a margin of one pitch.

    Args:
        columns, rows: numbers of dots.
        pitch_m: distance between centres.
        diameter_m: diameter of a dot.
        marker_diameter_m: diameter of three larger dots near the centre that show up and right; 0 for none.

    Raises:
        BadInputError: markers on a board of fewer than 5 columns or 3 rows, or more dots than its texture holds.
    """
    if columns * rows > _MOST_DOTS:
        raise BadInputError(f"A dot board of {columns} x {rows} has more than {_MOST_DOTS} dots; make it smaller.")
    if marker_diameter_m > 0 and (columns < 5 or rows < 3):
        raise BadInputError(f"A dot board of {columns} x {rows} has no room for markers; 5 x 3 is the least.")
    diameter = np.full((rows, columns), diameter_m)
    if marker_diameter_m > 0:
        row, column = rows // 2, columns // 2
        diameter[[row, row, row - 1], [column, column + 2, column]] = marker_diameter_m
    across, down = (np.arange((count + 1) * _TEXELS_PER_PITCH) + 0.5 for count in (columns, rows))
    x, y = np.meshgrid(across / _TEXELS_PER_PITCH - 1, down / _TEXELS_PER_PITCH - 1)
    column_index = np.clip(np.rint(x), 0, columns - 1).astype(int)
    row_index = np.clip(np.rint(y), 0, rows - 1).astype(int)
    distance = np.hypot(x - column_index, y - row_index) - 0.5 * diameter[row_index, column_index] / pitch_m
    paint = 1 - textures.inside(distance, 1 / _TEXELS_PER_PITCH)
    board = rectangle("dot_board", (columns + 1) * pitch_m, (rows + 1) * pitch_m)
    return replace(board, texture=textures.encoded(np.repeat(paint[..., None], 3, axis=-1)))
