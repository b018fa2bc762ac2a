"""Procedural meshes: grids of points, boxes, plain shapes in one colour, a ball, and the dot board.

Triangles run counter-clockwise seen from outside, normals point outwards, metres. A texture's uv is (0, 0) at its
top-left corner.
"""

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
    """Return a grid of points as a mesh: seen from outside, the columns run right and the rows run down.

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


def rectangle(name: str, width: float, height: float) -> Mesh:
    """Return a rectangle facing +z, centred at the origin, texture upright."""
    x, y = 0.5 * width, 0.5 * height
    position = np.array([[[-x, y, 0], [x, y, 0]], [[-x, -y, 0], [x, -y, 0]]])
    return from_grid(name, position, np.broadcast_to([0.0, 0.0, 1.0], position.shape))


def turn(about_x: float, about_y: float, about_z: float) -> FloatArray:
    """Return the rotation (3, 3) by angles in radians about the fixed axes z, then x, then y: roll, pitch, yaw."""
    about = transforms.rotation_about
    return about("y", about_y) @ about("x", about_x) @ about("z", about_z)


_TEXELS_PER_PITCH = 40
_MOST_DOTS = 10_000


def plane(width_m: float = 1.0, height_m: float = 1.0, colour: Colour = (0.7, 0.7, 0.7)) -> Mesh:
    """Return a rectangle facing +z, origin at its centre."""
    return replace(rectangle("plane", width_m, height_m), base_colour=np.array(colour, np.float32))


_FACES = ((0, 0), (0, 180), (0, 90), (0, -90), (-90, 0), (90, 0))
"""Angles about x and y in degrees that turn a rectangle facing +z to a face of a box."""


def box(size_m: Colour = (0.1, 0.1, 0.1), colour: Colour = (0.7, 0.7, 0.7)) -> Mesh:
    """Return a box of width, height, depth, origin at the middle of its bottom; each face has the texture upright."""
    half = 0.5 * np.asarray(size_m)
    positions, normals, triangles = [], [], []
    for number, (about_x, about_y) in enumerate(np.deg2rad(_FACES)):
        rotation = turn(about_x, about_y, 0.0)
        right, up, out = half @ np.abs(rotation)
        face = rectangle("box", 2 * right, 2 * up)
        positions.append((face.position + [0.0, 0.0, out]) @ rotation.T + [0.0, half[1], 0.0])
        normals.append(face.normal @ rotation.T)
        triangles.append(face.triangles + 4 * number)
    position, normal = (np.concatenate(each).astype(np.float32) for each in (positions, normals))
    uv = None if face.uv is None else np.tile(face.uv, (len(_FACES), 1))
    index = np.concatenate(triangles).astype(np.uint32)
    return Mesh("box", position, normal, index, np.array(colour, np.float32), uv)


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
