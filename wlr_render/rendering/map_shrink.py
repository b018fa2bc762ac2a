"""How much a warp shrinks the intermediate image, and how many samples a display pixel needs against aliasing."""

import math

import numpy as np

from wlr_render.geometry.pinhole import Pinhole
from wlr_render.mappings import EyeMappings
from wlr_render.numerics.arrays import Float32Array, FloatArray
from wlr_render.rendering.lattice import Lattice
from wlr_render.rendering.ray_field import solve_pixels

SPACING_PX = 1.25
"""Bilinear samples this far apart in the image miss none of it: each reaches a pixel to either side."""
MAX_TAPS = 4
_POINTS = 33


def largest_shrink(bend: Float32Array, lattice: Lattice, camera: Pinhole, size_px: tuple[int, int]) -> float:
    """Image pixels that one pixel of the display picture covers, in the direction and at the place where it is most.

    The largest singular value of the map's derivative for points at infinity, by differences between lattice points; 0
    if no ray is known.

    Args:
        bend: (4, rows, columns) in the image's camera frame, at the points of `lattice`; at least 2 x 2.
        lattice: where.
        camera: of the image.
        size_px: (width, height) of the display picture, which covers the panel.
    """
    points_per_pixel = lattice.panel.size_px / size_px / lattice.step_px
    at_infinity = camera.pixel_of_tangents(np.moveaxis(bend[:2].astype(np.float64), 0, -1))
    down, across = np.gradient(at_infinity, axis=(0, 1))
    across, down = across * points_per_pixel[0], down * points_per_pixel[1]
    squares = (across**2 + down**2).sum(axis=-1)
    area = across[..., 0] * down[..., 1] - across[..., 1] * down[..., 0]
    largest_squared = 0.5 * (squares + np.sqrt(np.maximum(squares**2 - 4 * area**2, 0.0)))
    return float(np.sqrt(np.max(largest_squared, initial=0.0, where=np.isfinite(largest_squared))))


def shrink_over_eye_box(
    mappings: EyeMappings, device_from_camera: FloatArray, camera: Pinhole, size_px: tuple[int, int]
) -> float:
    """`largest_shrink` of an eye's field at the centre of the eye box and at its nearest and farthest corners.

    Args:
        mappings: any pair.
        device_from_camera: (3, 3) axes of the camera.
        camera: of the image.
        size_px: (width, height) of the display picture.
    """
    lattice = Lattice.edge_to_edge(mappings.display.panel, _POINTS, _POINTS)
    box, pixel = mappings.eye_box, lattice.panel_pixel()
    bends = [
        solve_pixels(mappings, device_from_camera, pixel, box.at(unit)).bend
        for unit in np.array([[0.0, 0, 0], [1, 1, 1], [-1, -1, -1]])
    ]
    return max(largest_shrink(np.moveaxis(bend, -1, 0).astype(np.float32), lattice, camera, size_px) for bend in bends)


def taps_for(shrink: float) -> int:
    """Samples per display pixel along each axis, 1 to MAX_TAPS, for `largest_shrink`."""
    return min(max(math.ceil(shrink / SPACING_PX), 1), MAX_TAPS)
