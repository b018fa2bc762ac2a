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
            self._tiles, self._around, self._blocks = self._targets(image.inverse_depth.size)
        self._draw(self._of_tiles, self._tiles, values=image.inverse_depth)
        self._draw(self._of_blocks, self._blocks, values=self._tiles)
        self._draw(self._of_neighbours, self._around, ranges=self._tiles)
        return DepthRanges(self._around, self._blocks)

    def _targets(self, size: tuple[int, int]) -> tuple[gl.Texture, gl.Texture, gl.Texture]:
        tiles = -(-size[0] // TILE), -(-size[1] // TILE)
        blocks = -(-tiles[0] // TILE), -(-tiles[1] // TILE)
        of_tiles, around, of_blocks = (self._context.target(each, 2, "f4") for each in (tiles, tiles, blocks))
        return of_tiles, around, of_blocks

    def _draw(self, pass_: gl.VertexArray, target: gl.Texture, **textures: gl.Texture) -> None:
        self._context.framebuffer([target]).use()
        gl.bind_textures(pass_.program, **textures)
        pass_.render(vertices=3)
