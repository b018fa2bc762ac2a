"""A rendered image on the GPU, and the bounds of its inverse depths."""

from collections.abc import Callable, Sequence
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
    """Colour and inverse depth in textures that the renderer's next image overwrites.

    Attributes:
        context: context of the textures.
        camera: camera of the image.
        colour: (height, width), top row first, in a format whose samples are linear light: SRGB8_ALPHA8, whose texels
            are sRGB codes, or RGBA16F or RGBA32F.
        inverse_depth: (height, width) R32F, 1/m, 0 for background.
        view: view from which it was drawn, if this library drew it.
        is_overwritten: whether its renderer has since drawn another view into its textures.
        encoding: encoding of the texels: "srgb" codes or "linear" light.
        has_alpha: whether the picture's colours are premultiplied with its alpha; otherwise alpha has no meaning.
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
        """Fetch the image, with colours as sRGB codes."""
        with self.context.drawing():
            inverse_depth = gl.read(self.inverse_depth, np.float32)
            if self.encoding == "linear":
                light = gl.read(self.colour, np.float16 if self.colour.dtype == "f2" else np.float32)
                return GeometryImage(encode_srgb(light[..., :3].astype(np.float32)), inverse_depth)
            return GeometryImage(rgb_of_rgba(gl.read(self.colour, np.uint8)), inverse_depth)


class LatestViews:
    """Latest view drawn under each name, which shows whether a picture was overwritten."""

    def __init__(self) -> None:
        self._views: dict[str, View] = {}

    def drawn(self, name: str, view: View) -> Callable[[], bool]:
        """Record a drawing; return its picture's `GpuImage.is_overwritten`. The same view again overwrites nothing."""
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


@dataclass(frozen=True, eq=False)
class DepthRanges:
    """Smallest and largest inverse depths of an image, as RG32F textures.

    Attributes:
        tiles: ranges of tiles of TILE x TILE px, from the upper left corner.
        pyramid: see `range_pyramid.frag`.
    """

    tiles: gl.Texture
    pyramid: gl.Texture


class GlDepthRanges:
    """Computes `DepthRanges`, and keeps them for two images; textures are reused between images of one size."""

    def __init__(self, context: gl.GlContext) -> None:
        self._targets = gl.RenderTargets(context), gl.RenderTargets(context)
        self._kept: list[tuple[GpuImage, DepthRanges]] = []  # newest first
        with context.drawing():
            self._of_image = gl.Pass(context, "tile_range.frag", TILE=TILE)
            self._of_tiles = gl.Pass(context, "range_pyramid.frag", TILE=TILE)

    def forget(self) -> None:
        """Compute the ranges of the next image, even of one that is kept."""
        self._kept = []

    def of(self, image: GpuImage) -> DepthRanges:
        """Return an image's ranges, in textures that the image after the next overwrites. Call in a `drawing` block.

        An image that is warped again, such as for a newer pose, reuses its ranges.
        """
        for kept, ranges in self._kept:
            if kept is image:
                if kept is not self._kept[0][0]:
                    self._kept, self._targets = self._kept[::-1], self._targets[::-1]
                return ranges
        self._targets = self._targets[::-1]
        count = _tiled(image.inverse_depth.size)
        (tiles,) = self._draw("tiles", self._of_image, count, inverse_depths=image.inverse_depth)
        of_tiles = {"large_tiles": image.inverse_depth, "tiles": tiles}
        (large,) = self._draw("large tiles", self._of_tiles, _tiled(count), **of_tiles)
        side = 1 << max(2, (-(-max(count) // 2) - 1).bit_length())
        (pyramid,) = self._draw("pyramid", self._of_tiles, (2 * side, side), large_tiles=large, tiles=tiles)
        self._kept = [(image, DepthRanges(tiles, pyramid)), *self._kept[:1]]
        return self._kept[0][1]

    def _draw(self, name: str, filling: gl.Pass, size: tuple[int, int], **textures: gl.Texture) -> Sequence[gl.Texture]:
        target = self._targets[0].get(name, size, (2, "f4"))
        filling.fill(target, textures)
        return target.textures


def _tiled(size: tuple[int, int]) -> tuple[int, int]:
    """Return the numbers of tiles that cover an image."""
    return -(-size[0] // TILE), -(-size[1] // TILE)
