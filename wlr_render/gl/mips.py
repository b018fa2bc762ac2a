"""Mip levels of textures, filtered by our own shader.

Drivers differ in the filters for textures with odd sides: NVIDIA's leave out the last row or column, so that everything
drawn from such a level is displaced.
"""

import ctypes
from typing import Any

from wlr_render.gl import gl

_TEXTURE_2D = 0x0DE1


class MipLevels:
    """Fills mip levels: each texel is the mean of the texels of level 0 that it covers, weighted by area."""

    def __init__(self, context: gl.GlContext) -> None:
        self._context, self._targets = context, gl.RenderTargets(context)
        with context.drawing():
            self._drawing = context.full_screen("mip_level.frag")
        self._copy = context.function("glCopyTexSubImage2D", ctypes.c_uint, *[ctypes.c_int] * 7)

    def fill(self, texture: gl.Texture) -> None:
        """Fill a texture's levels from level 0, in linear light, and set trilinear filtering.

        Call it in a drawing block.

        Args:
            texture: texture of four components, "f1", "f2" or "srgb", from `GlContext.target`; a shader reads light
                from it, premultiplied with alpha.
        """
        gl.make_mip_levels(texture)
        self.refill(texture)

    def refill(self, texture: gl.Texture, holds_codes: bool = False) -> None:
        """Fill existing levels; with `holds_codes`, shaders read sRGB codes from the texture, not light."""
        sizes = level_sizes(texture.size)
        for level in range(1, len(sizes)):
            self._fill(texture, level, sizes, holds_codes)

    def _fill(self, texture: gl.Texture, level: int, sizes: list[tuple[int, int]], holds_codes: bool) -> None:
        finer = _uncut(sizes, level)
        width, height = sizes[level]
        largest = sizes[1][0], sizes[0][1]
        across = self._targets.get("across", largest, (4, "f4"))
        down = self._targets.get(f"down {texture.dtype}", sizes[1], (4, texture.dtype))
        narrow = width, sizes[finer][1]
        axis: dict[str, Any] = {"along_x": True, "count": width, "decodes": holds_codes, "encodes": False}
        self._shrink(texture, finer, sizes[finer], across, narrow, axis)
        encodes = holds_codes or gl.is_srgb(texture)
        axis = {"along_x": False, "count": height, "decodes": False, "encodes": encodes}
        self._shrink(across.textures[0], 0, narrow, down, (width, height), axis)
        texture.use(self._context.texture_unit)
        self._copy(_TEXTURE_2D, level, 0, 0, 0, 0, width, height)

    def _shrink(
        self,
        finer: gl.Texture,
        level: int,
        size: tuple[int, int],
        target: gl.RenderTarget,
        shrunk: tuple[int, int],
        axis: dict[str, Any],
    ) -> None:
        program = self._drawing.program
        gl.bind_textures(program, finer=finer)
        gl.set_uniforms(program, level=level, size=size, **axis)
        target.framebuffer.viewport = (0, 0, *shrunk)
        self._context.draw_to(target.framebuffer)
        self._drawing.render(vertices=3)


def level_sizes(size: tuple[int, int]) -> list[tuple[int, int]]:
    """Return (width, height) of each mip level, down to one texel."""
    return [(max(1, size[0] >> level), max(1, size[1] >> level)) for level in range(max(size).bit_length())]


def _uncut(sizes: list[tuple[int, int]], level: int) -> int:
    """Return the coarsest finer level whose texels this level's texels do not cut; else level 0."""
    fitting = (
        finer
        for finer in range(level)
        if all(side % count == 0 for side, count in zip(sizes[finer], sizes[level], strict=True))
    )
    return max(fitting, default=0)
