"""Warping an intermediate image along bent rays, on the GPU; the rule is in `warped_image.py`."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from wlr_render.rendering import gl
from wlr_render.rendering.gpu_image import GpuImage, lens_of, rgb_of_rgba
from wlr_render.rendering.warped_image import MAX_STEPS, SETTLED_PX, SURFACE_STEP, WarpedImage, WarpStatus

_TILE, _ALL = 16, 1 << 15
_CONSTANTS = {status.name: int(status) for status in WarpStatus} | {
    "MAX_STEPS": MAX_STEPS,
    "SETTLED_PX": SETTLED_PX,
    "SURFACE_STEP": SURFACE_STEP,
}


@dataclass(frozen=True, eq=False)
class _Targets:
    interleaved: NDArray[np.float32]
    bend: gl.Texture
    colour: gl.Texture
    source: gl.Texture
    without_source: gl.Framebuffer
    with_source: gl.Framebuffer


class GlWarp:
    """Warps pictures that lie on the GPU; its textures are kept between frames of one size."""

    def __init__(self, context: gl.GlContext) -> None:
        self._context = context
        self._targets: _Targets | None = None
        self._tiles: tuple[gl.Texture, gl.Texture] | None = None
        with context.drawing():
            self._warp = context.full_screen("warp.frag", "warp.vert", **_CONSTANTS)
            self._largest = context.full_screen("largest.frag")

    def warp(
        self,
        image: GpuImage,
        bend: NDArray[np.float32],
        background: tuple[int, int, int] = (0, 0, 0),
        with_source: bool = False,
    ) -> WarpedImage:
        """The picture that the display must show.

        Args:
            image: drawn from the viewpoint of the ray field, in this object's context.
            bend: (4, height, width) float32, (a, b, c, d) of each display pixel, as `RayField.bend`.
            background: sRGB for pixels that show nothing of the image.
            with_source: fetch the pull map as well.
        """
        with self._context.drawing():
            targets = self._targets_for(bend.shape[2], bend.shape[1])
            # One read of four components costs the shader much less than four reads.
            targets.bend.write(cv2.merge(list(bend), targets.interleaved))
            largest = self._largest_inverse_depth(image)
            (targets.with_source if with_source else targets.without_source).use()
            textures = {
                "bend": targets.bend,
                "picture": image.colour,
                "inverse_depth": image.inverse_depth,
                "largest_inverse_depth": largest,
            }
            gl.bind_textures(self._warp.program, **textures)
            gl.set_uniforms(
                self._warp.program, lens=lens_of(image.camera), background=tuple(x / 255 for x in background)
            )
            self._warp.render(vertices=3)
            rgba = gl.read(targets.colour, np.uint8)
            source = gl.read(targets.source, np.float32) if with_source else None
        return WarpedImage(rgb_of_rgba(rgba), np.ascontiguousarray(rgba[..., 3]), source)

    def _largest_inverse_depth(self, image: GpuImage) -> gl.Texture:
        """A texture of one texel, made in two steps: tiles, then all."""
        values = image.inverse_depth
        for texture, tile in zip(self._tiles_for(values.size), (_TILE, _ALL), strict=True):
            self._context.framebuffer([texture]).use()
            gl.bind_textures(self._largest.program, values=values)
            gl.set_uniforms(self._largest.program, tile=tile)
            self._largest.render(vertices=3)
            values = texture
        return values

    def _targets_for(self, width: int, height: int) -> _Targets:
        if self._targets is None or self._targets.colour.size != (width, height):
            colour = self._context.target((width, height), 4, "f1")
            source = self._context.target((width, height), 2, "f4")
            self._targets = _Targets(
                np.empty((height, width, 4), np.float32),
                self._context.target((width, height), 4, "f4"),
                colour,
                source,
                self._context.framebuffer([colour]),
                self._context.framebuffer([colour, source]),
            )
        return self._targets

    def _tiles_for(self, size: tuple[int, int]) -> tuple[gl.Texture, gl.Texture]:
        of_tiles = -(-size[0] // _TILE), -(-size[1] // _TILE)
        if self._tiles is None or self._tiles[0].size != of_tiles:
            self._tiles = self._context.target(of_tiles, 1, "f4"), self._context.target((1, 1), 1, "f4")
        return self._tiles
