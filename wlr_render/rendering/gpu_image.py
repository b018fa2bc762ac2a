"""A drawn picture that has stayed on the GPU."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from wlr_render.geometry.pinhole import Pinhole
from wlr_render.rendering import gl
from wlr_render.rendering.view import GeometryImage


@dataclass(frozen=True, eq=False)
class GpuImage:
    """Colour and inverse depth as textures; the drawer's next picture overwrites them.

    Attributes:
        context: whose textures they are.
        camera: drawn with.
        colour: (height, width) RGBA8 sRGB, top row first.
        inverse_depth: (height, width) R32F, 1/m, 0 where nothing is.
    """

    context: gl.GlContext
    camera: Pinhole
    colour: gl.Texture
    inverse_depth: gl.Texture

    def read(self) -> GeometryImage:
        """Fetch it."""
        with self.context.drawing():
            return GeometryImage(rgb_of_rgba(gl.read(self.colour, np.uint8)), gl.read(self.inverse_depth, np.float32))


def rgb_of_rgba(rgba: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Drop alpha: (height, width, 4) -> (height, width, 3). Faster than letting the driver read three of four."""
    return np.asarray(cv2.cvtColor(rgba, cv2.COLOR_RGBA2RGB))


def lens_of(camera: Pinhole) -> tuple[float, float, float, float]:
    """The shaders' `lens`: focal_u, focal_v, centre_u, centre_v in pixels."""
    (focal_u, focal_v), (centre_u, centre_v) = camera.focal_px, camera.centre_px
    return float(focal_u), float(focal_v), float(centre_u), float(centre_v)
