"""Backward warp of an intermediate image on the GPU; `warp.py` states the algorithm."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from wlr_render.errors import BadInputError
from wlr_render.geometry.pinhole import Pinhole
from wlr_render.mappings import Panel
from wlr_render.numerics.arrays import FloatArray
from wlr_render.rendering import gl
from wlr_render.rendering.gl_ray_maps import RayTexture
from wlr_render.rendering.gpu_image import GlDepthRanges, GpuImage, rgb_of_rgba
from wlr_render.rendering.warp import (
    CONVERGED_PX,
    MAX_REFINEMENTS,
    MAX_STEPS,
    STEP_PX,
    SURFACE_STEP,
    TILE,
    WarpedImage,
    WarpStatus,
)
from wlr_render.rendering.warp_grid import WarpGrid

_CONSTANTS = {status.name: int(status) for status in WarpStatus} | {
    "STEP_PX": STEP_PX,
    "MAX_STEPS": MAX_STEPS,
    "MAX_REFINEMENTS": MAX_REFINEMENTS,
    "CONVERGED_PX": CONVERGED_PX,
    "SURFACE_STEP": SURFACE_STEP,
    "TILE": TILE,
}


@dataclass(frozen=True, eq=False)
class WarpTarget:
    """The viewport of a framebuffer that a warped picture is drawn to.

    Attributes:
        framebuffer: its first colour is drawn to; alpha becomes 1.
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
        colour: RGBA8 sRGB, alpha 1, top row first.
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
            colour = rgb_of_rgba(gl.read(self.colour, np.uint8))
            source = None if self.source is None else gl.read(self.source, np.float32)
            return WarpedImage(colour, gl.read(self.status, np.uint8), source)


class GlWarp:
    """Warps images on the GPU; textures are reused between frames of one size."""

    def __init__(self, context: gl.GlContext, channels: int = 1) -> None:
        """Prepare for one ray map, or for 3: one per colour channel (red, green, blue)."""
        self._context, self._channels = context, channels
        self._ranges = GlDepthRanges(context)
        self._targets = gl.RenderTargets(context)
        self._passes: dict[tuple[tuple[str, int], ...], gl.VertexArray] = {}

    def draw(
        self,
        image: GpuImage,
        ray_maps: Sequence[RayTexture],
        image_from_ray_map: FloatArray,
        size_px: tuple[int, int],
        background: tuple[int, int, int] = (0, 0, 0),
        samples_per_axis: int = 1,
        with_source: bool = False,
    ) -> GpuWarped:
        """Draw the display image and leave it on the GPU.

        Args:
            image: in this object's context.
            ray_maps: world rays, one for each channel.
            image_from_ray_map: rigid, from the camera frame of the ray maps to that of the image, (4, 4), or
                (height, 4, 4) with one for each row of the display.
            size_px: (width, height) of the picture, which covers the panel.
            background: sRGB for pixels that show nothing of the image.
            samples_per_axis: samples per pixel along each axis, see `raster_camera.samples_for`.
            with_source: make the pull map as well.

        Raises:
            BadInputError: the number of ray maps or the shape of the transforms does not fit.
        """
        with self._context.drawing():
            source_format = [(2, "f4")] if with_source else []
            made = self._targets.get(f"source {with_source}", size_px, (4, "f1"), (1, "u1"), *source_format)
            target = WarpTarget(made.framebuffer, (0, 0), size_px, True)
            constants = {"SAMPLES_PER_AXIS": samples_per_axis, "WITH_STATUS": 1, "WITH_SOURCE": int(with_source)}
            self._draw(image, ray_maps, image_from_ray_map, target, background, **constants)
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
    ) -> None:
        """Draw the colour of the same image into a caller's framebuffer; arguments and errors as `draw`."""
        with self._context.drawing():
            before = target.framebuffer.viewport
            constants = {"SAMPLES_PER_AXIS": samples_per_axis, "WITH_STATUS": 0, "WITH_SOURCE": 0}
            try:
                self._draw(image, ray_maps, image_from_ray_map, target, background, **constants)
            finally:
                target.framebuffer.viewport = before

    def warp(
        self,
        image: GpuImage,
        slope_offset: NDArray[np.float32] | Sequence[NDArray[np.float32]],
        image_from_ray_map: FloatArray | None = None,
        background: tuple[int, int, int] = (0, 0, 0),
        samples_per_axis: int = 1,
        with_source: bool = False,
    ) -> WarpedImage:
        """As `draw` along rays (4, height, width) of each display pixel, of all channels or of one each; fetched.

        The rays are in the image's own frame if `image_from_ray_map` is None.
        """
        slope_offsets = [slope_offset] if isinstance(slope_offset, np.ndarray) else slope_offset
        ray_maps = [self._uploaded(f"ray {channel}", each) for channel, each in enumerate(slope_offsets)]
        if len(ray_maps) == 1:
            ray_maps *= self._channels
        moved = np.eye(4) if image_from_ray_map is None else image_from_ray_map
        size_px = slope_offsets[0].shape[2], slope_offsets[0].shape[1]
        return self.draw(image, ray_maps, moved, size_px, background, samples_per_axis, with_source).read()

    def _uploaded(self, name: str, slope_offset: NDArray[np.float32]) -> RayTexture:
        _, height, width = slope_offset.shape
        with self._context.drawing():
            texture = self._targets.get(name, (width, height), (4, "f4")).textures[0]
            # One read of four components costs the shader much less than four reads.
            texture.write(cv2.merge(list(slope_offset)))
        return RayTexture(WarpGrid.of_pixels(Panel(width, height)), texture)

    def _draw(
        self,
        image: GpuImage,
        ray_maps: Sequence[RayTexture],
        image_from_ray_map: FloatArray,
        target: WarpTarget,
        background: tuple[int, int, int],
        **constants: int,
    ) -> None:
        _check(len(ray_maps), self._channels, image_from_ray_map, target.size_px)
        ranges = self._ranges.of(image)
        by_rows = image_from_ray_map.ndim == 3
        warp = self._pass(ROWS=int(by_rows), FIELD_BY_TEXELS=self._by_texels(ray_maps, target.size_px), **constants)
        from_fragment = _display_from_fragment(target)
        matrices = _camera_matrices(image.camera, image_from_ray_map)
        textures: dict[str, gl.Texture | Sequence[gl.Texture]] = {
            "slope_offset": [_sampled(each, target.size_px) for each in ray_maps],
            "picture": image.colour,
            "inverse_depth": image.inverse_depth,
            "ranges": ranges.around_tiles,
            "coarse_ranges": ranges.coarse,
        }
        if by_rows:
            textures["camera_matrices"] = self._camera_matrices_texture(matrices)
            gl.set_uniforms(warp.program, row_from_fragment=tuple(from_fragment[:, 1]))
        else:
            gl.set_array(warp.program, "camera_matrix", list(matrices))
        gl.bind_textures(warp.program, **textures)
        gl.set_array(
            warp.program, "texture_from_fragment", [_chained(each, target, from_fragment) for each in ray_maps]
        )
        gl.set_uniforms(warp.program, background=tuple(x / 255 for x in background))
        target.framebuffer.viewport = (*target.first_px, *target.size_px)
        target.framebuffer.use()
        warp.render(vertices=3)

    def _by_texels(self, ray_maps: Sequence[RayTexture], size_px: tuple[int, int]) -> int:
        """1 if a ray map is read between its points where filters have weights of 8 bits, which costs some 0.1'."""
        between = not all(each.warp_grid.has_pixel_centres_of(size_px) for each in ray_maps)
        return int(between and not self._context.is_software)

    def _pass(self, **constants: int) -> gl.VertexArray:
        key = tuple(constants.items())
        if key not in self._passes:
            self._passes[key] = self._context.full_screen(
                "warp.frag", "warp.vert", "", CHANNELS=self._channels, **_CONSTANTS, **constants
            )
        return self._passes[key]

    def _camera_matrices_texture(self, matrices: FloatArray) -> gl.Texture:
        texture = self._targets.get("camera_matrices", (3, len(matrices)), (4, "f4")).textures[0]
        texture.write(np.ascontiguousarray(matrices, np.float32))
        return texture


def _check(count: int, channels: int, image_from_ray_map: FloatArray, size_px: tuple[int, int]) -> None:
    if count != channels:
        raise BadInputError(f"{count} ray maps for a warp of {channels} channels; give one ray map for each channel.")
    if image_from_ray_map.shape not in ((4, 4), (size_px[1], 4, 4)):
        raise BadInputError(
            f"image_from_ray_map has the shape {image_from_ray_map.shape}; give (4, 4), or ({size_px[1]}, 4, 4) with "
            "one transform for each row of the display."
        )


def _sampled(rays: RayTexture, size_px: tuple[int, int]) -> gl.Texture:
    # A filter between points spreads a NaN to its neighbours; where each pixel has its own point it need not.
    (gl.read_at_texels if rays.warp_grid.has_pixel_centres_of(size_px) else gl.read_between_texels)(rays.slope_offset)
    return rays.slope_offset


def _camera_matrices(camera: Pinhole, image_from_ray_map: FloatArray) -> FloatArray:
    """(..., 3, 4): from a point (x, y, z, 1) of the ray map's frame to (u depth, v depth, depth) in the image."""
    (focal_u, focal_v), (centre_u, centre_v) = camera.focal_px, camera.centre_px
    lens = np.array([[focal_u, 0, -centre_u, 0], [0, -focal_v, -centre_v, 0], [0, 0, -1, 0]])
    return np.asarray(lens @ image_from_ray_map)


def _display_from_fragment(target: WarpTarget) -> FloatArray:
    """[scale, offset] (2, 2) from window coordinates to display pixels, rows down."""
    (x, y), height = target.first_px, target.size_px[1]
    return np.array([[1.0, 1.0], [-x, -y]]) if target.top_row_first else np.array([[1.0, -1.0], [-x, y + height]])


def _chained(rays: RayTexture, target: WarpTarget, display_from_fragment: FloatArray) -> FloatArray:
    """Scale and offset (4,) from window coordinates to where the ray map's texture is read."""
    scale, offset = rays.warp_grid.texture_from_picture(target.size_px)
    return np.concatenate([scale * display_from_fragment[0], scale * display_from_fragment[1] + offset])
