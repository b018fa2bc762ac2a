"""A rendered image on the GPU, and the pyramid of its inverse depths' bounds."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from wlr_render.geometry.pinhole import Pinhole
from wlr_render.gl import gl
from wlr_render.gl.readback import rgb_of_rgba
from wlr_render.numerics.srgb import encode_srgb
from wlr_render.warp.stored_picture import Encoding
from wlr_render.warp.view import GeometryImage, View
from wlr_render.warp.warp import TILE


@dataclass(frozen=True, eq=False)
class GpuImage:
    """Colour and inverse depth as textures, which the renderer's next image overwrites.

    Attributes:
        context: of the textures.
        camera: of the image.
        colour: (height, width), top row first, of a format whose samples are linear light: SRGB8_ALPHA8, whose texels
            are sRGB codes, or RGBA16F or RGBA32F.
        inverse_depth: (height, width) R32F, 1/m, 0 where nothing is.
        view: from where it was drawn, if this library drew it.
        is_overwritten: whether its renderer has since drawn another view into its textures.
        encoding: of the texels: "srgb" codes or "linear" light.
        has_alpha: whether the picture's colours are premultiplied with its alpha; otherwise alpha means nothing.
    """

    context: gl.GlContext
    camera: Pinhole
    colour: gl.Texture
    inverse_depth: gl.Texture
    view: View | None = None
    is_overwritten: Callable[[], bool] = lambda: False
    encoding: Encoding = "srgb"
    has_alpha: bool = False

    def read(self) -> GeometryImage:
        """Fetch it, as sRGB codes."""
        with self.context.drawing():
            inverse_depth = gl.read(self.inverse_depth, np.float32)
            if self.encoding == "linear":
                light = gl.read(self.colour, np.float16 if self.colour.dtype == "f2" else np.float32)
                return GeometryImage(encode_srgb(light[..., :3].astype(np.float32)), inverse_depth)
            return GeometryImage(rgb_of_rgba(gl.read(self.colour, np.uint8)), inverse_depth)


class LatestViews:
    """View of the latest drawing under each name, which tells pictures that another one has overwritten."""

    def __init__(self) -> None:
        self._views: dict[str, View] = {}

    def drawn(self, name: str, view: View) -> Callable[[], bool]:
        """Note a drawing; returns `GpuImage.is_overwritten` of its picture. The same view again shows the same."""
        self._views[name] = view
        return lambda: not _is_same(self._views[name], view)


def _is_same(one: View, other: View) -> bool:
    return (
        np.array_equal(one.world_from_camera, other.world_from_camera)
        and one.camera.size_px == other.camera.size_px
        and np.array_equal(one.camera.image_from_camera, other.camera.image_from_camera)
    )


def shader_intrinsics(camera: Pinhole) -> tuple[float, float, float, float]:
    """Return the shaders' `lens`: focal_u, focal_v, centre_u, centre_v in pixels."""
    (focal_u, focal_v), (centre_u, centre_v) = camera.focal_px, camera.centre_px
    return float(focal_u), float(focal_v), float(centre_u), float(centre_v)


class GlDepthRanges:
    """Computes the pyramid of bounds that `ranges.glsl` reads; textures are reused between images of one size."""

    def __init__(self, context: gl.GlContext) -> None:
        self._context, self._targets = context, gl.RenderTargets(context)
        self._last: tuple[GpuImage, gl.Texture] | None = None
        with context.drawing():
            self._of_tiles = context.full_screen("tile_range.frag", TILE=TILE)
            self._of_levels = context.full_screen("range_pyramid.frag")

    def of(self, image: GpuImage) -> gl.Texture:
        """RG32F, smallest and largest inverse depth; overwritten by the next image's. Call within a `drawing` block.

        An image that is warped again, as for a newer pose, has them already.
        """
        if self._last is not None and self._last[0] is image:
            return self._last[1]
        width, height = (-(-side // TILE) for side in image.inverse_depth.size)
        side = 1 << max(2, (max(width, height) - 1).bit_length())
        tiles = self._targets.get("tiles", (width, height), (2, "f4"))
        pyramid = self._targets.get("pyramid", (2 * side, side), (2, "f4"))
        _draw(self._context, self._of_tiles, tiles, values=image.inverse_depth)
        gl.set_uniforms(self._of_levels.program, target_height=side)
        _draw(self._context, self._of_levels, pyramid, tiles=tiles.textures[0])
        self._last = image, pyramid.textures[0]
        return pyramid.textures[0]


def _draw(context: gl.GlContext, full_screen: gl.VertexArray, target: gl.RenderTarget, **textures: gl.Texture) -> None:
    context.draw_to(target.framebuffer)
    gl.bind_textures(full_screen.program, **textures)
    full_screen.render(vertices=3)
