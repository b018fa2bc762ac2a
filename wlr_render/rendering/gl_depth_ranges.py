"""Between which inverse depths an image on the GPU lies, around each of its tiles and as a whole."""

from dataclasses import dataclass

from wlr_render.rendering import gl
from wlr_render.rendering.gpu_image import GpuImage
from wlr_render.rendering.warped_image import TILE


@dataclass(frozen=True, eq=False)
class DepthRanges:
    """Smallest and largest inverse depths, RG32F; the maker's next ones overwrite them.

    Attributes:
        around_tiles: a texel for each tile of TILE x TILE px: of the tile and the eight around it.
        coarse: a texel for each block of TILE x TILE tiles: of those alone.
    """

    around_tiles: gl.Texture
    coarse: gl.Texture


@dataclass(frozen=True, eq=False)
class _Target:
    texture: gl.Texture
    framebuffer: gl.Framebuffer


class GlDepthRanges:
    """Makes `DepthRanges`; its textures are kept between images of one size."""

    def __init__(self, context: gl.GlContext) -> None:
        self._context = context
        self._image_size: tuple[int, int] | None = None
        with context.drawing():
            self._of_tiles = context.full_screen("tile_range.frag", TILE=TILE, LOW=0, HIGH=0)
            self._of_blocks = context.full_screen("tile_range.frag", TILE=TILE, LOW=0, HIGH=1)
            self._of_neighbours = context.full_screen("neighbour_range.frag")

    def of(self, image: GpuImage) -> DepthRanges:
        """Call within a `drawing` block."""
        if self._image_size != image.inverse_depth.size:
            self._image_size = image.inverse_depth.size
            tiles = _tiles_of(self._image_size)
            self._tiles, self._around, self._blocks = map(self._target, (tiles, tiles, _tiles_of(tiles)))
        _draw(self._of_tiles, self._tiles, values=image.inverse_depth)
        _draw(self._of_blocks, self._blocks, values=self._tiles.texture)
        _draw(self._of_neighbours, self._around, ranges=self._tiles.texture)
        return DepthRanges(self._around.texture, self._blocks.texture)

    def _target(self, size: tuple[int, int]) -> _Target:
        texture = self._context.target(size, 2, "f4")
        return _Target(texture, self._context.framebuffer([texture]))


def _tiles_of(size: tuple[int, int]) -> tuple[int, int]:
    return -(-size[0] // TILE), -(-size[1] // TILE)


def _draw(full_screen: gl.VertexArray, target: _Target, **textures: gl.Texture) -> None:
    target.framebuffer.use()
    gl.bind_textures(full_screen.program, **textures)
    full_screen.render(vertices=3)
