"""Backward warp of an intermediate image on the GPU; `warp.py` states the algorithm."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from wlr_render.errors import BadInputError
from wlr_render.geometry.pinhole import pixels_from
from wlr_render.gl import gl
from wlr_render.gl.readback import read_rgb
from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.srgb import decode_srgb
from wlr_render.warp.gl_overlay import SeenOverlay
from wlr_render.warp.gl_panel import SRGB_ENCODER, PanelEncoder
from wlr_render.warp.gl_ray_maps import RayTexture
from wlr_render.warp.gpu_image import DepthRanges, GlDepthRanges, GpuImage
from wlr_render.warp.grid import WarpGrid
from wlr_render.warp.raster_camera import MAX_SAMPLES
from wlr_render.warp.warp import (
    DIRECT_PX,
    SPACING_PX,
    SURFACE_STEP,
    TILE,
    WarpedImage,
    WarpStatus,
)

MAX_OVERLAYS = 4
"""Overlays of an eye that are shown at once."""

CONSTANTS = {status.name: int(status) for status in WarpStatus} | {
    "SURFACE_STEP": SURFACE_STEP,
    "TILE": TILE,
    "DIRECT_PX": DIRECT_PX,
    "SPACING_PX": SPACING_PX,
    "MISSING": 1e30,
    "MAX_OVERLAYS": MAX_OVERLAYS,
    "MOST_SAMPLES": float(MAX_SAMPLES),
}


_Run = tuple[gl.Program | gl.ComputeShader, Callable[[], object]]
"""A program, and what runs it when its textures and uniforms are set."""


@dataclass(frozen=True, eq=False)
class WarpedPicture:
    """A picture that the warp reads.

    Attributes:
        image: colour and depth.
        samples_per_axis: most samples per display pixel along each axis, see `raster_camera.samples_for`. Each cell of
            the warp grid has as many as it needs.
    """

    image: GpuImage
    samples_per_axis: int = 1


@dataclass(frozen=True, eq=False)
class WarpTarget:
    """The viewport of a framebuffer that a warped picture is drawn to.

    Attributes:
        framebuffer: its first colour is drawn to, with the alpha of the picture.
        first_px: (x, y) of the picture's corner with the smallest window coordinates.
        size_px: (width, height) of the picture; nothing else of the framebuffer is touched.
        top_row_first: whether the picture's top row has the smallest window y, as in our own textures. False gives a
            picture that is upright in OpenGL's sense.
    """

    framebuffer: gl.Framebuffer
    first_px: tuple[int, int]
    size_px: tuple[int, int]
    top_row_first: bool


@dataclass(frozen=True, eq=False)
class GpuWarped:
    """A picture in display pixels, as textures that the warp's next pictures overwrite; see `WarpedImage`.

    Attributes:
        context: whose textures they are.
        colour: codes of the panel in the format of `PanelLight.bits`, top row first; alpha is the picture's, or 1.
        status: R8UI.
        source: RG32F, or None when not asked for.
    """

    context: gl.GlContext
    colour: gl.Texture
    status: gl.Texture
    source: gl.Texture | None

    def read(self) -> WarpedImage:
        """Fetch it."""
        with self.context.drawing():
            colour = read_rgb(self.colour)
            source = None if self.source is None else gl.read(self.source, np.float32)
            return WarpedImage(colour, gl.read(self.status, np.uint8), source)


class GlWarp:
    """Warps images on the GPU; textures are reused between frames of one size.

    A first pass finds, for each cell of the warp grid, where its rays appear in the image and at which inverse depths
    they may meet it. Cells that the image's depth moves by less than DIRECT_PX are sampled directly; pixels of the
    others search along their rays. Where the context computes, this pass and the warp are compute shaders, and
    `draw_into` copies the picture to its target. Elsewhere fragment shaders draw the cells, each kind in one call,
    because software renderers run both sides of a branch for every pixel.

    An inset, a sharper image of a part of the field of view, is drawn in the same way over the wider image; the wider
    image skips the cells that the inset fills. The inset's border blends into the wider image (`PictureImport.take`),
    so that no seam is visible.
    """

    def __init__(self, context: gl.GlContext, channels: int = 1, panel: PanelEncoder = SRGB_ENCODER) -> None:
        """Prepare for one ray map, or for 3: one per colour channel (red, green, blue)."""
        self._context, self._channels, self._panel = context, channels, panel
        self._cells: list[_GlCells] = []
        self._targets = gl.RenderTargets(context)
        self._drawings: dict[tuple[int, bool], gl.VertexArray] = {}

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
    ) -> GpuWarped:
        """Draw the display image and leave it on the GPU.

        Args:
            image: in this object's context.
            ray_maps: world rays at the points of one warp grid, one map for each channel.
            image_from_ray_map: rigid, from the camera frame of the ray maps to the image's, (4, 4), or
                (rows, 4, 4) with one for each row of the warp grid.
            size_px: (width, height) of the picture, which covers the panel.
            background: sRGB for pixels that show nothing of the image.
            samples_per_axis: of the image, as in `WarpedPicture`.
            with_source: make the pull map as well, in pixels of the image.
            overlays: pictures drawn over the image in this order, at most MAX_OVERLAYS.
            insets: of the image's camera frame, each within the picture before and sharper.

        Raises:
            BadInputError: the number of ray maps or the shape of the transforms does not fit.
        """
        with self._context.drawing():
            made = self._own_target(size_px, with_source)
            pictures = [WarpedPicture(image, samples_per_axis), *insets]
            self._draw(pictures, ray_maps, image_from_ray_map, made, background, overlays)
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
    ) -> None:
        """Draw the colour of the same image into a caller's framebuffer; arguments and errors as `draw`."""
        with self._context.drawing():
            before = target.framebuffer.viewport
            pictures = [WarpedPicture(image, samples_per_axis), *insets]
            drawn = pictures, ray_maps, image_from_ray_map
            try:
                if self._context.computes:
                    made = self._target_to_copy(target.size_px)
                    self._draw(*drawn, made, background, overlays)
                    self._copy(made.textures[0], target)
                else:
                    self._draw(*drawn, target, background, overlays)
            finally:
                target.framebuffer.viewport = before

    def _target_to_copy(self, size_px: tuple[int, int]) -> gl.RenderTarget:
        kind = (
            "nu2" if self._panel.texture_kind == "rgb10" else self._panel.texture_kind
        )  # 2 bits are too few for alpha
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
    ) -> None:
        """Draw to a caller's target, or to one of ours: by a compute shader where the context prefers it."""
        size_px = target.size_px if isinstance(target, WarpTarget) else target.framebuffer.size
        _check(ray_maps, self._channels, image_from_ray_map)
        while len(self._cells) < len(pictures):
            self._cells.append(_GlCells(self._context, self._channels))
        cells: list[_Cells] = []  # the sharpest picture comes first: a wider picture's cells depend on it
        for k in reversed(range(len(pictures))):
            drawn = pictures[k].image, ray_maps, image_from_ray_map, size_px
            cells.insert(0, self._cells[k].draw(*drawn, is_inset=k > 0, inset=cells[0] if cells else None))
        if isinstance(target, gl.RenderTarget) and self._context.computes:
            runs = self._computing(target, bool(overlays))
        else:
            if isinstance(target, gl.RenderTarget):
                target = WarpTarget(target.framebuffer, (0, 0), size_px, True)
            runs = self._drawing(target, ray_maps[0].warp_grid, bool(overlays))
        light = tuple(map(float, decode_srgb(np.array(background, np.uint8))))
        for k, (picture, of_picture) in enumerate(zip(pictures, cells, strict=True)):
            uniforms = {"background": light, "is_inset": k > 0}
            uniforms["widest_from_inset"] = pixels_from(picture.image.camera, pictures[0].image.camera)
            for program, run in runs:
                self._set(program, picture, of_picture, overlays, uniforms)
                run()

    def _drawing(self, target: WarpTarget, warp_grid: WarpGrid, overlays: bool) -> list[_Run]:
        """Return the programs of both kinds of cells, which draw to a target."""
        target.framebuffer.viewport = (*target.first_px, *target.size_px)
        self._context.draw_to(target.framebuffer)
        vertices = 6 * (warp_grid.columns - 1) * (warp_grid.rows - 1)
        runs: list[_Run] = []
        for march in (0, 1):
            key = march, overlays
            if key not in self._drawings:
                program = self._context.program("warp.vert", "warp.frag", MARCH=march, **self._constants(overlays))
                self._drawings[key] = self._context.no_vertices(program)
            drawing = self._drawings[key]
            gl.set_uniforms(drawing.program, top_row_first=target.top_row_first)
            runs.append((drawing.program, partial(drawing.render, vertices=vertices)))
        return runs

    def _computing(self, target: gl.RenderTarget, overlays: bool) -> list[_Run]:
        """Return the compute shader for all cells, which writes into a target's textures."""
        program = self._context.compute_program("warp.comp", **self._constants(overlays))
        gl.set_uniforms(program, with_source=len(target.textures) > 2)
        return [(program, partial(self._context.compute, program, target.textures))]

    def _constants(self, overlays: bool) -> dict[str, float]:
        return {"OVERLAYS": int(overlays), "CHANNELS": self._channels} | self._panel.constants | CONSTANTS

    def _copy(self, colour: gl.Texture, target: WarpTarget) -> None:
        """Copy a picture to a caller's target, whose format and number of samples may be any."""
        copying = self._context.full_screen("copy.frag")
        target.framebuffer.viewport = (*target.first_px, *target.size_px)
        self._context.draw_to(target.framebuffer)
        gl.bind_textures(copying.program, image=colour)
        height = 0 if target.top_row_first else target.size_px[1]
        gl.set_uniforms(copying.program, first_px=target.first_px, turned_height=height)
        copying.render(vertices=3)

    def _set(
        self,
        program: gl.Program | gl.ComputeShader,
        picture: WarpedPicture,
        cells: "_Cells",
        overlays: Sequence[SeenOverlay],
        uniforms: dict[str, Any],
    ) -> None:
        """Give a program the textures and uniforms of a picture."""
        image = picture.image
        gl.read_between_texels(image.colour)
        textures: dict[str, Any] = dict(self._panel.textures)
        if overlays:
            textures["overlays"] = [overlays[k % len(overlays)].texture for k in range(MAX_OVERLAYS)]
            places = np.zeros((3 * MAX_OVERLAYS, 3))
            on_quads = [each.place_of_ray @ image.camera.camera_from_image for each in overlays]
            places[: 3 * len(overlays)] = np.concatenate(on_quads)
            gl.set_array(program, "overlay_place", places)
            gl.set_uniforms(program, overlay_count=len(overlays))
        gl.bind_textures(
            program,
            paths=cells.paths,
            tiles=cells.ranges.tiles,
            bends=cells.bends,
            mixed_bends_and_ranges=cells.mixed_bends_and_ranges,
            picture=image.colour,
            inverse_depth=image.inverse_depth,
            **textures,
        )
        opaque, samples = 0.0 if image.has_alpha else 1.0, float(picture.samples_per_axis)
        gl.set_uniforms(program, opaque=opaque, most_samples_per_axis=samples, **uniforms)


@dataclass(frozen=True, eq=False)
class _Cells:
    """Outputs of `cells.frag` for a picture, and the bounds of the picture's depths."""

    paths: gl.Texture
    bends: gl.Texture
    mixed_bends_and_ranges: gl.Texture
    ranges: DepthRanges


class _GlCells:
    """Draws `cells.frag` for one picture of a frame: the widest, or an inset; textures are reused between frames."""

    def __init__(self, context: gl.GlContext, channels: int) -> None:
        self._channels = channels
        self._ranges, self._targets = GlDepthRanges(context), gl.RenderTargets(context)
        self._filling = gl.Pass(context, "cells.frag", CHANNELS=channels, **CONSTANTS)

    def draw(
        self,
        image: GpuImage,
        ray_maps: Sequence[RayTexture],
        image_from_ray_map: FloatArray,
        display_size_px: tuple[int, int],
        is_inset: bool,
        inset: _Cells | None,
    ) -> _Cells:
        """Find the cells of a picture, which may be an inset, and may have one."""
        ranges = self._ranges.of(image)
        warp_grid = ray_maps[0].warp_grid
        matrices = image.camera.image_from_camera @ image_from_ray_map
        by_rows = matrices.ndim == 3
        cells = self._targets.get("cells", (warp_grid.columns, warp_grid.rows * self._channels), *[(4, "f4")] * 3)
        program = self._filling.program
        rays = [each.slope_offset for each in ray_maps]
        # The tiles stay on their unit for the warp. Unused samplers share a texture: they must not read a target.
        unused = dict.fromkeys(("row_matrices", "inset_ranges"), rays[0])
        textures: dict[str, Any] = {"ranges": ranges.pyramid, "tiles": ranges.tiles, "slope_offset": rays, **unused}
        if by_rows:
            rows = self._targets.get("row matrices", (3, warp_grid.rows), (4, "f4")).textures[0]
            rows.write(np.ascontiguousarray(matrices, np.float32))
            textures["row_matrices"] = rows
        else:
            gl.set_array(program, "camera_matrix", matrices)
        if inset is not None:
            textures["inset_ranges"] = inset.mixed_bends_and_ranges
        gl.set_uniforms(program, has_row_matrices=by_rows, is_inset=is_inset, has_inset=inset is not None)
        gl.bind_textures(program, **textures)
        per_cell = (display_size_px[0] / (warp_grid.columns - 1), display_size_px[1] / (warp_grid.rows - 1))
        size_px = image.inverse_depth.size
        gl.set_uniforms(program, size_px=tuple(map(float, size_px)), display_px_per_cell=per_cell)
        self._filling.fill(cells)
        paths, bends, mixed_bends_and_ranges = cells.textures
        return _Cells(paths, bends, mixed_bends_and_ranges, ranges)


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
