"""A rendered image on the GPU, and the range of its inverse depths around each tile."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from wlr_render.geometry.pinhole import Pinhole
from wlr_render.rendering import gl
from wlr_render.rendering.view import GeometryImage
from wlr_render.rendering.warp import TILE


@dataclass(frozen=True, eq=False)
class GpuImage:
    """Colour and inverse depth as textures, which the renderer's next image overwrites.

    Attributes:
        context: of the textures.
        camera: of the image.
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


def shader_intrinsics(camera: Pinhole) -> tuple[float, float, float, float]:
    """The shaders' `lens`: focal_u, focal_v, centre_u, centre_v in pixels."""
    (focal_u, focal_v), (centre_u, centre_v) = camera.focal_px, camera.centre_px
    return float(focal_u), float(focal_v), float(centre_u), float(centre_v)


@dataclass(frozen=True, eq=False)
class DepthRanges:
    """Smallest and largest inverse depths per tile, RG32F; the next image's overwrite them.

    Attributes:
        around_tiles: a texel for each tile of TILE x TILE px: of the tile and the eight around it.
        coarse: a texel for each block of TILE x TILE tiles: of those alone.
    """

    around_tiles: gl.Texture
    coarse: gl.Texture


class GlDepthRanges:
    """Computes `DepthRanges`; textures are reused between images of one size."""

    def __init__(self, context: gl.GlContext) -> None:
        self._targets = gl.RenderTargets(context)
        with context.drawing():
            self._of_tiles = context.full_screen("tile_range.frag", TILE=TILE, LOW=0, HIGH=0)
            self._of_blocks = context.full_screen("tile_range.frag", TILE=TILE, LOW=0, HIGH=1)
            self._of_neighbours = context.full_screen("neighbour_range.frag")

    def of(self, image: GpuImage) -> DepthRanges:
        """Call within a `drawing` block."""
        tiles = _tiles_of(image.inverse_depth.size)
        sizes = {"tiles": tiles, "blocks": _tiles_of(tiles), "around": tiles}
        of_tiles, of_blocks, around = (self._targets.get(name, size, (2, "f4")) for name, size in sizes.items())
        _draw(self._of_tiles, of_tiles, values=image.inverse_depth)
        _draw(self._of_blocks, of_blocks, values=of_tiles.textures[0])
        _draw(self._of_neighbours, around, ranges=of_tiles.textures[0])
        return DepthRanges(around.textures[0], of_blocks.textures[0])


def _tiles_of(size: tuple[int, int]) -> tuple[int, int]:
    return -(-size[0] // TILE), -(-size[1] // TILE)


def _draw(full_screen: gl.VertexArray, target: gl.RenderTarget, **textures: gl.Texture) -> None:
    target.framebuffer.use()
    gl.bind_textures(full_screen.program, **textures)
    full_screen.render(vertices=3)
