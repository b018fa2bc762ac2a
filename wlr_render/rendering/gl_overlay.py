"""Overlays: flat pictures at a distance, which the warp composites over the panel images."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from wlr_render.errors import BadInputError
from wlr_render.geometry import transforms
from wlr_render.geometry.pinhole import Pinhole
from wlr_render.input_files import LIMITS
from wlr_render.numerics.arrays import FloatArray
from wlr_render.rendering import gl
from wlr_render.rendering.picture_import import PictureImport
from wlr_render.rendering.stored_picture import Rows, StoredColour, StoredDepth
from wlr_render.rendering.view import View

_NEAREST_M = 1e-3
"""An overlay is not shown from nearer to its plane, nor from behind."""


@dataclass(frozen=True, eq=False)
class Quad:
    """A rectangle in the plane z = 0 of its own frame, x right and y up, seen from +z.

    Attributes:
        pose: (4, 4), world_from_quad, or device_from_quad of one that moves with the head.
        size_m: (2,) width and height, with the frame's origin in the middle.
        is_head_locked: which of them.
    """

    pose: FloatArray
    size_m: FloatArray
    is_head_locked: bool

    def place_of_pixel(self, view: View, world_from_device: FloatArray) -> FloatArray | None:
        """Homogeneous place on the quad of a pixel of a view: (3, 3), None if the quad is seen from behind or edge-on.

        Rows times (u, v, 1) are x w, y w and w, with the place (x, y) from (0, 0) in the upper left to (1, 1), and the
        inverse depth w of the quad's plane at the pixel.
        """
        world_from_quad = world_from_device @ self.pose if self.is_head_locked else self.pose
        quad_from_camera = transforms.inverse(world_from_quad) @ view.world_from_camera
        (focal_u, focal_v), (centre_u, centre_v) = view.camera.focal_px, view.camera.centre_px
        ray_of_pixel = np.array(
            [[1 / focal_u, 0, -centre_u / focal_u], [0, -1 / focal_v, centre_v / focal_v], [0, 0, -1]]
        )
        x, y, z = quad_from_camera[:3, :3] @ ray_of_pixel
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
    """An overlay with `Quad.place_of_pixel`, (3, 3)."""

    texture: gl.Texture
    place_of_pixel: FloatArray


class OverlayImport:
    """Copies the pictures of overlays; each overwrites the last."""

    def __init__(self, context: gl.GlContext) -> None:
        self._context, self._import = context, PictureImport(context)

    def take(self, picture: Any, quad: Quad, stored_colour: StoredColour, rows: Rows | None) -> Overlay:
        """A picture as an array, a ModernGL texture, or as a layer of one.

        Raises:
            BadInputError: another type, or as `PictureImport.take`.
        """
        is_array = isinstance(picture, np.ndarray)
        if not is_array and not isinstance(picture, gl.Texture):
            raise BadInputError(
                f"an overlay cannot be taken from a {type(picture).__name__}; give an array (height, width, 3 or 4), "
                "or a ModernGL texture."
            )
        shape = picture.shape[1::-1] if is_array else (0, 0) if gl.is_released(picture) else picture.size
        if is_array and (picture.ndim != 3 or not all(0 < side <= self._context.largest_side_px for side in shape)):
            raise BadInputError(
                f"the overlay has the shape {picture.shape}; give (height, width, 3 or 4), with sides of "
                f"{min(self._context.largest_side_px, LIMITS.picture_side)} at most."
            )
        # Its depth is not used: of a texture the red component passes for it.
        depth = np.ones(shape[::-1], np.float32) if is_array else picture
        camera = Pinhole(shape[0], shape[1], -np.ones(2), np.ones(2))
        image = self._import.take(camera, picture, depth, StoredDepth(), rows, stored_colour)
        with self._context.drawing():
            gl.read_between_levels(image.colour)
        return Overlay(image.colour, quad)
