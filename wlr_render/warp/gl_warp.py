"""Backward warp of an intermediate image on the GPU; `warp.py` states the algorithm."""

import contextlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from wlr_render.errors import BadInputError
from wlr_render.geometry.pinhole import pixels_from
from wlr_render.gl import gl
from wlr_render.gl.readback import read_rgb
from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.srgb import decode_srgb
from wlr_render.warp.gl_cells import MAX_OVERLAYS, WARP_CONSTANTS, GlCells, WarpCells
from wlr_render.warp.gl_overlay import SeenOverlay
from wlr_render.warp.gl_panel import SRGB_ENCODER, PanelEncoder
from wlr_render.warp.gl_ray_maps import RayTexture
from wlr_render.warp.gpu_image import GlDepthRanges, GpuImage
from wlr_render.warp.grid import WarpGrid
from wlr_render.warp.warp import WarpedImage

_Fill = Callable[..., None]
"""Draws a picture from textures by sampler name and uniforms as keywords."""


@dataclass(frozen=True, eq=False)
class WarpedPicture:
    """A picture that the warp reads.

    Attributes:
        image: colour and depth.
        samples_per_axis: largest number of samples per display pixel along each axis, see `raster_camera.samples_for`.
            Each cell of the warp grid uses as many as it needs.
    """

    image: GpuImage
    samples_per_axis: int = 1


@dataclass(frozen=True, eq=False)
class Backdrop:
    """An older picture, shown where the newest one is DISOCCLUDED.

    Attributes:
        picture: picture of another view.
        image_from_ray_map: transform to this picture's camera frame, see `GlWarp.draw`.
        overlays: the newest picture's overlays, as its camera sees them.
    """

    picture: WarpedPicture
    image_from_ray_map: FloatArray
    overlays: Sequence[SeenOverlay] = ()


@dataclass(frozen=True, eq=False)
class WarpTarget:
    """The viewport of a framebuffer that a warped picture is drawn to.

    Attributes:
        framebuffer: framebuffer whose first colour is drawn to, with the alpha of the picture.
        first_px: (x, y) of the picture's corner with the smallest window coordinates.
        size_px: (width, height) of the picture; nothing else of the framebuffer is touched.
        top_row_first: whether the picture's top row has the smallest window y, as in our own textures. If False, the
            picture is upright in OpenGL's sense.
    """

    framebuffer: gl.Framebuffer
    first_px: tuple[int, int]
    size_px: tuple[int, int]
    top_row_first: bool


@dataclass(frozen=True, eq=False)
class GpuWarped:
    """A picture in display pixels, in textures that the warp's next picture overwrites; see `WarpedImage`.

    Attributes:
        context: context of the textures.
        colour: codes of the panel in the format of `PanelLight.bits`, top row first; alpha is the picture's, or 1.
        status: R8UI texture.
        source: RG32F texture, or None if not requested.
    """

    context: gl.GlContext
    colour: gl.Texture
    status: gl.Texture
    source: gl.Texture | None

    def read(self) -> WarpedImage:
        """Fetch the picture."""
        with self.context.drawing():
            colour = read_rgb(self.colour)
            source = None if self.source is None else gl.read(self.source, np.float32)
            return WarpedImage(colour, gl.read(self.status, np.uint8), source)


class GlWarp:
    """Warps images on the GPU; textures are reused between frames of one size.

    A first pass finds, for each cell of the warp grid, where its rays appear in the image and at which inverse depths
    they may meet it. Cells that the image's depth moves by less than DIRECT_PX are sampled directly; pixels of other
    cells search along their rays. Where the context computes (`GlContext.computes`), this pass and the warp are compute
    shaders, and `draw_into` copies the picture to its target. Otherwise fragment shaders draw the cells, each kind in
    one call, because software renderers run both sides of a branch for every pixel.

    An inset, a sharper image of a part of the field of view, is drawn in the same way over the wider image; the wider
    image skips the cells that the inset fills. The inset's border blends into the wider image (`PictureImport.take`),
    so that no seam is visible.

    A backdrop, an older picture of another view, is drawn where the newest one is DISOCCLUDED. Its surfaces nearer than
    the middle depth of the newest picture's cell are not used: they may have moved since.
    """

    def __init__(self, context: gl.GlContext, channels: int = 1, panel: PanelEncoder = SRGB_ENCODER) -> None:
        """Prepare for one ray map, or for three: one per colour channel (red, green, blue)."""
        self._context, self._channels, self._panel = context, channels, panel
        self._ranges = GlDepthRanges(context)  # depth ranges of the widest picture and of the backdrop
        self._cells: list[GlCells] = []
        self._backdrop_cells: GlCells | None = None
        self._targets = gl.RenderTargets(context)
        self._colours: WeakKeyDictionary[gl.RenderTarget, gl.RenderTarget] = WeakKeyDictionary()
        self._drawings: dict[tuple[int, bool, int], gl.VertexArray] = {}
        self._passes: dict[bool, gl.Pass] = {}

    def draw(
        self,
        image: GpuImage,
        ray_maps: Sequence[RayTexture],
        image_from_ray_map: FloatArray,
        size_px: tuple[int, int],
        background: tuple[int, int, int] = (0, 0, 0),
        samples_per_axis: int = 1,
        with_source: bool = False,
        overlays: Sequence[SeenOverlay] = (),
        insets: Sequence[WarpedPicture] = (),
        backdrop: Backdrop | None = None,
    ) -> GpuWarped:
        """Draw the display image and leave it on the GPU; in a block `Dispatches.together`, at the block's end.

        Args:
            image: image in this object's context.
            ray_maps: world rays at the points of one warp grid, one map for each channel.
            image_from_ray_map: rigid transform from the camera frame of the ray maps to the image's, (4, 4), or (rows,
                4, 4) with one for each row of the warp grid.
            size_px: (width, height) of the picture, which covers the panel.
            background: sRGB for pixels that show nothing of the image.
            samples_per_axis: samples of the image, see `WarpedPicture`.
            with_source: True to draw the pull map as well, in pixels of the image.
            overlays: pictures drawn over the image in this order, at most MAX_OVERLAYS.
            insets: pictures in the image's camera frame, each within the picture before and sharper.
            backdrop: picture that is shown where image and insets are DISOCCLUDED; status and pull map are unaffected.

        Raises:
            BadInputError: the number of ray maps or the shape of the transforms does not fit.
        """
        with self._context.drawing():
            made = self._own_target(size_px, with_source)
            pictures = [WarpedPicture(image, samples_per_axis), *insets]
            self._draw(pictures, ray_maps, image_from_ray_map, made, background, overlays, backdrop)
        colour, status, *source = made.textures
        return GpuWarped(self._context, colour, status, source[0] if source else None)

    def draw_into(
        self,
        target: WarpTarget,
        image: GpuImage,
        ray_maps: Sequence[RayTexture],
        image_from_ray_map: FloatArray,
        background: tuple[int, int, int] = (0, 0, 0),
        samples_per_axis: int = 1,
        overlays: Sequence[SeenOverlay] = (),
        insets: Sequence[WarpedPicture] = (),
        backdrop: Backdrop | None = None,
    ) -> None:
        """Draw the colour alone into a caller's framebuffer; see `draw`."""
        with self._context.drawing():
            pictures = [WarpedPicture(image, samples_per_axis), *insets]
            drawn = pictures, ray_maps, image_from_ray_map
            if self._context.computes or backdrop is not None:
                made = self._target_to_copy(target.size_px)
                self._draw(*drawn, made, background, overlays, backdrop)
                self._context.dispatches.add(partial(self._copy, made.textures[0], target))
                return
            with _viewport_kept(target):
                self._draw(*drawn, target, background, overlays, backdrop)

    def forget(self) -> None:
        """Compute all again for the next picture."""
        for each in self._cells:
            each.ranges.forget()

    def _target_to_copy(self, size_px: tuple[int, int]) -> gl.RenderTarget:
        kind = (
            "nu2" if self._panel.texture_kind == "rgb10" else self._panel.texture_kind
        )  # two bits are too few for alpha
        return self._targets.get("to copy", size_px, (4, kind), (1, "u1"))

    def _own_target(self, size_px: tuple[int, int], with_source: bool) -> gl.RenderTarget:
        source_format = [(2, "f4")] if with_source else []
        kinds = (4, self._panel.texture_kind), (1, "u1"), *source_format
        return self._targets.get(f"source {with_source}", size_px, *kinds)

    def _draw(
        self,
        pictures: Sequence[WarpedPicture],
        ray_maps: Sequence[RayTexture],
        image_from_ray_map: FloatArray,
        target: WarpTarget | gl.RenderTarget,
        background: tuple[int, int, int],
        overlays: Sequence[SeenOverlay],
        backdrop: Backdrop | None,
    ) -> None:
        """Draw to a caller's target, or to one of ours; with a compute shader if `GlContext.computes`."""
        size_px = target.size_px if isinstance(target, WarpTarget) else target.framebuffer.size
        _check(ray_maps, self._channels, image_from_ray_map)
        if backdrop is not None:
            drawn = backdrop.picture.image, ray_maps, backdrop.image_from_ray_map, size_px
            self._backdrop_cells = self._backdrop_cells or GlCells(self._context, self._channels, self._ranges)
            backdrop_cells = self._backdrop_cells.draw(*drawn, is_inset=False, inset=None)
        cells = self._drawn_cells(pictures, ray_maps, image_from_ray_map, size_px)
        light = tuple(map(float, decode_srgb(np.array(background, np.uint8))))
        for k, (picture, front) in enumerate(zip(pictures, cells, strict=True)):
            uniforms = {"background": light, "is_inset": k > 0, "widest_from_inset": (1.0, 1.0, 0.0, 0.0)}
            if k > 0:
                uniforms["widest_from_inset"] = pixels_from(picture.image.camera, pictures[0].image.camera)
            textures, of_picture = self._inputs(picture, front, overlays or None)
            for fill in self._fills(target, ray_maps[0].warp_grid, bool(overlays)):
                fill(textures, **of_picture, **uniforms)
            if backdrop is not None:
                assert isinstance(target, gl.RenderTarget), "a backdrop reads the status of the pictures before it"
                fill = self._fills(self._without_status(target), ray_maps[0].warp_grid, bool(overlays))[-1]
                over = backdrop.overlays if overlays else None
                textures, of_picture = self._inputs(backdrop.picture, backdrop_cells, over, front, target.textures[1])
                fill(textures, **of_picture, **uniforms | {"is_inset": False})

    def _without_status(self, target: gl.RenderTarget) -> gl.RenderTarget:
        """Return a target of the colour alone, to draw to while the status is read."""
        if target not in self._colours:
            colour = target.textures[0]
            self._colours[target] = gl.RenderTarget(self._context.framebuffer([colour]), (colour,))
        return self._colours[target]

    def _drawn_cells(
        self,
        pictures: Sequence[WarpedPicture],
        ray_maps: Sequence[RayTexture],
        image_from_ray_map: FloatArray,
        size_px: tuple[int, int],
    ) -> list[WarpCells]:
        while len(self._cells) < len(pictures):
            ranges = GlDepthRanges(self._context) if self._cells else self._ranges
            self._cells.append(GlCells(self._context, self._channels, ranges))
        cells: list[WarpCells] = []  # the sharpest picture comes first: a wider picture's cells depend on it
        for k in reversed(range(len(pictures))):
            drawn = pictures[k].image, ray_maps, image_from_ray_map, size_px
            cells.insert(0, self._cells[k].draw(*drawn, is_inset=k > 0, inset=cells[0] if cells else None))
        return cells

    def _fills(self, target: WarpTarget | gl.RenderTarget, warp_grid: WarpGrid, overlays: bool) -> list[_Fill]:
        """Return functions that draw to a target: one per kind of cells, or one for both; the last follows depth."""
        if isinstance(target, gl.RenderTarget):
            if self._context.computes:
                if overlays not in self._passes:
                    self._passes[overlays] = gl.Pass(self._context, "warp.comp", **self._constants(overlays))
                return [partial(self._passes[overlays].fill, target, with_source=len(target.textures) > 2)]
            target = WarpTarget(target.framebuffer, (0, 0), target.framebuffer.size, True)
        target.framebuffer.viewport = (*target.first_px, *target.size_px)
        self._context.draw_to(target.framebuffer)
        cells = (warp_grid.columns - 1) * (warp_grid.rows - 1)
        fills: list[_Fill] = []
        for march in (0, 1):
            key = march, overlays, cells
            if key not in self._drawings:
                of_cells = self._context.program("warp.vert", "warp.frag", MARCH=march, **self._constants(overlays))
                self._drawings[key] = self._context.triangles(of_cells, {}, _triangles_of(cells))
            fills.append(partial(_fill_cells, self._drawings[key], top_row_first=target.top_row_first))
        return fills

    def _constants(self, overlays: bool) -> dict[str, float]:
        return {"OVERLAYS": int(overlays), "CHANNELS": self._channels} | self._panel.constants | WARP_CONSTANTS

    def _copy(self, colour: gl.Texture, target: WarpTarget) -> None:
        """Copy a picture to a caller's target of any format and number of samples."""
        copying = self._context.full_screen("copy.frag")
        with _viewport_kept(target):
            self._context.draw_to(target.framebuffer)
            gl.bind_textures(copying.program, image=colour)
            height = 0 if target.top_row_first else target.size_px[1]
            gl.set_uniforms(copying.program, first_px=target.first_px, turned_height=height)
            copying.render(vertices=3)

    def _inputs(
        self,
        picture: WarpedPicture,
        cells: WarpCells,
        overlays: Sequence[SeenOverlay] | None,
        front: WarpCells | None = None,
        front_status: gl.Texture | None = None,
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Return textures and uniforms of a picture; overlays are None for a program without them.

        For a backdrop they include cells and status of the picture in front.
        """
        image = picture.image
        gl.read_between_texels(image.colour)
        textures: dict[str, Any] = {
            "paths": cells.paths,
            "tiles": cells.ranges.tiles,
            "bends": cells.bends,
            "mixed_bends_and_ranges": cells.mixed_bends_and_ranges,
            "front_ranges": (front or cells).mixed_bends_and_ranges,
            "front_status": front_status or self._context.no_status,
            "picture": image.colour,
            "inverse_depth": image.inverse_depth,
            **self._panel.textures,
        }
        uniforms: dict[str, Any] = {
            "opaque": 0.0 if image.has_alpha else 1.0,
            "most_samples_per_axis": float(picture.samples_per_axis),
            "is_backdrop": front is not None,
        }
        if overlays is not None:
            given = [each.texture for each in overlays]
            textures["overlays"] = given + [image.colour] * (MAX_OVERLAYS - len(given))
            places = np.zeros((MAX_OVERLAYS, 3, 3))
            for place, overlay in zip(places, overlays, strict=False):
                place[:] = overlay.place_of_ray @ image.camera.camera_from_image
            uniforms |= {"overlay_place": gl.floats(places), "overlay_count": len(overlays)}
        return textures, uniforms


def _fill_cells(drawing: gl.VertexArray, textures: dict[str, Any], **uniforms: Any) -> None:
    gl.bind_textures(drawing.program, **textures)
    gl.set_uniforms(drawing.program, **uniforms)
    drawing.render()


@contextlib.contextmanager
def _viewport_kept(target: WarpTarget) -> Iterator[None]:
    """Draw to the target's viewport in a block, and restore the framebuffer's at its end."""
    before, target.framebuffer.viewport = target.framebuffer.viewport, (*target.first_px, *target.size_px)
    try:
        yield
    finally:
        target.framebuffer.viewport = before


def _triangles_of(cells: int) -> NDArray[np.uint32]:
    """Return the vertices (cells, 6) of both triangles of each cell, with corners numbered by rows.

    The last vertex of a triangle provides the values that hold for the whole triangle.
    """
    return np.array([1, 2, 0, 1, 2, 3], np.uint32) + 4 * np.arange(cells, dtype=np.uint32)[:, None]


def _check(ray_maps: Sequence[RayTexture], channels: int, image_from_ray_map: FloatArray) -> None:
    if len(ray_maps) != channels or len({each.warp_grid.size for each in ray_maps}) > 1:
        raise BadInputError(
            f"{len(ray_maps)} ray maps for a warp of {channels} channels; give one ray map for each channel, all of "
            "one warp grid."
        )
    rows = ray_maps[0].warp_grid.rows
    if image_from_ray_map.shape not in ((4, 4), (rows, 4, 4)):
        raise BadInputError(
            f"image_from_ray_map has the shape {image_from_ray_map.shape}; give (4, 4), or ({rows}, 4, 4) with one "
            "transform for each row of the warp grid."
        )
