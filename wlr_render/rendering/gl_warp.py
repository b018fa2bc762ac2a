"""Warping an intermediate image along bent rays, on the GPU.

For each display pixel the ray field has (a, b, c, d): in the camera frame of the intermediate image the world ray
passes through (c, d, 0) with tangents (a, b). A point of it at inverse depth w appears in the image at

    s(w) = (f_u (a + c w) + c_u, -f_v (b + d w) + c_v),

and what is visible there has inverse depth D(s). The ray meets what the image shows where D(s(w)) = w. The rule:

1. The search starts from the largest inverse depth W of the whole image, w = D(s(W)) of the nearest texel: where a
   near and a far surface both satisfy the equation, the near one hides the far one, and it is come to first.
2. w <- D(s(w)) until s moves by less than SETTLED_PX: the last s is the source position, SEEN. On a surface whose
   inverse depth rises by g per pixel the step shrinks by |f c g| (about 1e-3) each time: one step mostly does.
3. After MAX_STEPS without settling, s goes to and fro across an edge between two surfaces, neither of which the ray
   meets: it goes behind the near one, to what the image does not show. Of the last two positions that one is taken
   where the image shows the farther surface: DISOCCLUDED.
4. A position outside 0..width, 0..height is OUTSIDE; a NaN in the field is NO_RAY.

D is bilinear where its four texels differ by at most SURFACE_STEP of the largest (exact for planes, whose inverse
depth is linear in the pixel), else the nearest texel; beyond the border it repeats the border's texels. The background
has w = 0 and is met at (a, b). Colour is bilinear in the 8-bit sRGB values, as cv2.remap does, by four texel reads:
the hardware's own filter has 8-bit weights.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from wlr_render.rendering import gl
from wlr_render.rendering.gpu_image import GpuImage, lens_of, rgb_of_rgba
from wlr_render.rendering.warped_image import WarpedImage, WarpStatus

MAX_STEPS = 6
SETTLED_PX = 0.01
SURFACE_STEP = 0.02

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
            self._warp = context.full_screen("warp.frag", **_CONSTANTS)
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
