"""Plain shapes in one colour, and the dot board."""

from dataclasses import replace

import numpy as np

from wlr_render.errors import BadInputError
from wlr_render.numerics.arrays import FloatArray
from wlr_render.rendering.scene import Mesh
from wlr_render.rendering.shapes import construction, textures
from wlr_render.rendering.shapes.construction import Colour

_TEXELS_PER_PITCH = 40


def plane(width_m: float = 1.0, height_m: float = 1.0, colour: Colour = (0.7, 0.7, 0.7)) -> Mesh:
    """A rectangle facing +z, origin at its centre."""
    return replace(construction.rectangle("plane", width_m, height_m), base_colour=np.array(colour, np.float32))


def box(size_m: Colour = (0.1, 0.1, 0.1), colour: Colour = (0.7, 0.7, 0.7)) -> Mesh:
    """A box of width, height, depth, origin at the middle of its bottom."""
    return replace(construction.cuboid("box", size_m), base_colour=np.array(colour, np.float32))


def sphere(radius_m: float = 0.05, colour: Colour = (0.7, 0.7, 0.7), segments: int = 64) -> Mesh:
    """A sphere, origin at its centre."""
    return replace(_globe("sphere", radius_m, segments), base_colour=np.array(colour, np.float32))


def ball(radius_m: float = 0.06) -> Mesh:
    """A beach ball, origin at its centre."""
    skin = textures.stripes(("e4572e", "fdf6e3", "2e86ab", "fdf6e3", "f3a712", "fdf6e3"))
    return replace(_globe("ball", radius_m, 64), texture=skin)


def _globe(name: str, radius: float, segments: int) -> Mesh:
    latitude = np.linspace(0.5 * np.pi, -0.5 * np.pi, segments // 2 + 1)
    longitude = np.linspace(0, 2 * np.pi, segments + 1)
    x = np.cos(latitude)[:, None] * np.sin(longitude)
    y = np.repeat(np.sin(latitude)[:, None], segments + 1, axis=1)
    z = np.cos(latitude)[:, None] * np.cos(longitude)
    normal = np.stack([x, y, z], axis=-1)
    return construction.from_grid(name, radius * normal, normal)


def dot_centres(columns: int, rows: int, pitch_m: float) -> FloatArray:
    """Centres of a board's dots in its own frame, (rows, columns, 3): x right, y up, origin at the board's centre."""
    x = (np.arange(columns) - 0.5 * (columns - 1)) * pitch_m
    y = (0.5 * (rows - 1) - np.arange(rows)) * pitch_m
    grid = np.meshgrid(x, y)
    return np.stack([*grid, np.zeros((rows, columns))], axis=-1)


def dot_board(
    columns: int = 25,
    rows: int = 19,
    pitch_m: float = 0.02,
    diameter_m: float = 0.008,
    marker_diameter_m: float = 0.0,
) -> Mesh:
    """A white board of black round dots facing +z, origin at its centre, one pitch of margin around the outer dots.

    Args:
        columns, rows: of dots.
        pitch_m: between centres.
        diameter_m: of a dot.
        marker_diameter_m: of three larger dots near the centre that tell up and right; 0 for none.

    Raises:
        BadInputError: markers on a board of fewer than 5 columns or 3 rows.
    """
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
    board = construction.rectangle("dot_board", (columns + 1) * pitch_m, (rows + 1) * pitch_m)
    return replace(board, texture=textures.encoded(np.repeat(paint[..., None], 3, axis=-1)))
