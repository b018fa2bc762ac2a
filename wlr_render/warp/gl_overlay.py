"""Overlays: flat pictures at a distance, which the warp composites over the panel images."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from wlr_render.errors import BadInputError
from wlr_render.geometry import transforms
from wlr_render.gl import gl
from wlr_render.gl.mips import MipLevels
from wlr_render.io.input_files import LIMITS
from wlr_render.numerics.arrays import FloatArray
from wlr_render.warp.picture_import import PictureImport, is_texture
from wlr_render.warp.stored_picture import Rows, StoredColour
from wlr_render.warp.view import View

_NEAREST_M = 1e-3
"""Smallest distance from its plane at which an overlay is shown; it is never shown from behind."""


@dataclass(frozen=True, eq=False)
class Quad:
    """A rectangle in the plane z = 0 of the quad frame, x right and y up, visible from +z.

    Attributes:
        pose: (4, 4) world_from_quad, or device_from_quad for a quad that moves with the head.
        size_m: (2,) width and height; the frame's origin is in the middle.
        is_head_locked: whether `pose` is device_from_quad.
    """

    pose: FloatArray
    size_m: FloatArray
    is_head_locked: bool

    def place_of_ray(self, view: View, world_from_device: FloatArray) -> FloatArray | None:
        """Return the map (3, 3) from directions to homogeneous positions on the quad; None if it is seen from behind.

        Its rows times a direction in the view's camera frame with z = -1 are x w, y w and w, with the position (x, y)
        from (0, 0) in the upper left to (1, 1), and the inverse depth w of the quad's plane in that direction.
        """
        world_from_quad = world_from_device @ self.pose if self.is_head_locked else self.pose
        quad_from_camera = transforms.inverse(world_from_quad) @ view.world_from_camera
        x, y, z = quad_from_camera[:3, :3]
        at_x, at_y, at_z = quad_from_camera[:3, 3]
        if at_z < _NEAREST_M:
            return None
        inverse_depth = -z / at_z
        width, height = self.size_m
        across = 0.5 * inverse_depth + (x + at_x * inverse_depth) / width
        down = 0.5 * inverse_depth - (y + at_y * inverse_depth) / height
        return np.stack([across, down, inverse_depth])


@dataclass(frozen=True, eq=False)
class Overlay:
    """A premultiplied picture in linear light, with mip levels, on a quad."""

    texture: gl.Texture
    quad: Quad


@dataclass(frozen=True, eq=False)
class SeenOverlay:
    """An overlay with its `Quad.place_of_ray` (3, 3)."""

    texture: gl.Texture
    place_of_ray: FloatArray


class OverlayImport:
    """Copies the pictures of overlays; each copy overwrites the last."""

    def __init__(self, context: gl.GlContext) -> None:
        self._context, self._import, self._levels = context, PictureImport(context), MipLevels(context)

    def take(self, picture: Any, quad: Quad, stored_colour: StoredColour, rows: Rows | None) -> Overlay:
        """Return a picture as an array, or as a texture of any kind that `PictureImport.colour_alone` takes.

        Raises:
            BadInputError: a picture of another type; see also `PictureImport.colour_alone`.
        """
        is_array = isinstance(picture, np.ndarray)
        if not is_array and not is_texture(picture):
            raise BadInputError(
                f"an overlay cannot be taken from a {type(picture).__name__}; give an array (height, width, 3 or 4), "
                "or a texture (ModernGL's, its OpenGL name, or TextureLayer)."
            )
        largest_px = self._context.largest_side_px
        if is_array and (picture.ndim != 3 or not all(0 < side <= largest_px for side in picture.shape[:2])):
            raise BadInputError(
                f"the overlay has the shape {picture.shape}; give (height, width, 3 or 4), with sides of "
                f"{min(largest_px, LIMITS.picture_side)} at most."
            )
        texture = self._import.colour_alone(picture, stored_colour, rows)
        with self._context.drawing():
            self._levels.fill(texture)
        return Overlay(texture, quad)
