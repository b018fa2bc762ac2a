"""Compositor backend in OpenGL, on a GPU or a software renderer, with the caller's framebuffers as targets."""

import contextlib
import ctypes
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from numbers import Integral
from typing import Any

import numpy as np

from wlr_render.compositing.backend import CachedRayMaps
from wlr_render.errors import BadInputError
from wlr_render.geometry.pinhole import Pinhole
from wlr_render.mappings import EyeMappings, PlanarDisplay, PlanarSeeThrough, count_unsolved
from wlr_render.numerics.arrays import FloatArray
from wlr_render.rendering import gl
from wlr_render.rendering.cpu_ray_maps import RayMapSolver
from wlr_render.rendering.framebuffers import COLOUR, DRAW, FramebufferQueries
from wlr_render.rendering.gl_ray_maps import GlNodeSolver, GlPlanarSolver, GpuRayMap
from wlr_render.rendering.gl_warp import GlWarp, GpuWarped, WarpTarget
from wlr_render.rendering.gpu_image import GpuImage
from wlr_render.rendering.picture_import import PictureImport
from wlr_render.rendering.raster_camera import EyePlan
from wlr_render.rendering.ray_map import RayMap, RayMapPlan, choose_plan
from wlr_render.rendering.stored_picture import Rows, StoredDepth
from wlr_render.rendering.warp import WarpedImage
from wlr_render.rendering.warp_grid import WarpGrid

_DRAW_BUFFERS = range(0x8825, 0x8825 + 8)  # GL_DRAW_BUFFER0 and on
_ON, _OFF = (True,) * 4, (False,) * 4


class CallersFramebuffers:
    """The caller's framebuffers as targets; use it in drawing blocks."""

    def __init__(self, context: gl.GlContext) -> None:
        self._context, self._ask = context, FramebufferQueries(context)
        # ModernGL never frees what it makes for a number, so that one is made for each.
        self._by_number: dict[int, gl.Framebuffer] = {}

    def targets(self, into: Any, eyes: Sequence[str], size_px: tuple[int, int]) -> dict[str, WarpTarget]:
        """Where each eye's picture goes, upright as OpenGL shows it; see `Compositor.compose`.

        Raises:
            BadInputError: an eye has none, one is no framebuffer of this context, or of another size or kind.
        """
        if isinstance(into, Mapping):
            missing = set(eyes) - set(into)
            if missing:
                raise BadInputError(
                    f"there is no framebuffer for the {sorted(missing)[0]} eye; give one for every eye."
                )
            found = {eye: self._of_size(into[eye], size_px) for eye in eyes}
            if len({framebuffer.glo for framebuffer in found.values()}) < len(found):
                raise BadInputError(
                    "both eyes are given the same framebuffer; give each its own, or one of twice the width."
                )
            return {eye: WarpTarget(framebuffer, (0, 0), size_px, False) for eye, framebuffer in found.items()}
        width, height = size_px
        framebuffer = self._of_size(into, (width * len(eyes), height))
        return {
            eye: WarpTarget(framebuffer, (index * width, 0), size_px, top_row_first=False)
            for index, eye in enumerate(eyes)
        }

    @contextlib.contextmanager
    def draw_buffers_kept(self, framebuffer: gl.Framebuffer) -> Iterator[None]:
        """Give a framebuffer object its draw buffers back: ModernGL switches on all that it has."""
        number, ask = int(framebuffer.glo), self._ask
        if not number:
            yield
            return
        ask.bind(number, DRAW)
        buffers = (ctypes.c_uint * len(_DRAW_BUFFERS))(*map(ask.integer, _DRAW_BUFFERS))
        try:
            yield
        finally:
            ask.bind(number, DRAW)
            ask.gl("glDrawBuffers", ctypes.c_int, ctypes.c_void_p)(len(buffers), buffers)

    def _of_size(self, into: Any, size_px: tuple[int, int]) -> gl.Framebuffer:
        if isinstance(into, gl.Framebuffer) and not self._context.has(into):
            raise BadInputError("the framebuffer belongs to another OpenGL context than the compositor works in.")
        number = into.glo if isinstance(into, gl.Framebuffer) else into
        if not isinstance(number, Integral):
            raise BadInputError(f"a {type(into).__name__} is not a framebuffer; give ModernGL's, or an OpenGL number.")
        framebuffer = self._checked(int(number))
        # The size of a window's picture is its toolkit's affair: OpenGL cannot be asked for it.
        size = self._ask.measure(COLOUR)[:2] if number else into.size if into is not number else size_px
        if tuple(size) != size_px:
            found, needed = (" x ".join(map(str, pixels)) for pixels in (size, size_px))
            raise BadInputError(
                f"the framebuffer has {found} pixels, and {needed} are needed; give one of that size, or make the "
                "compositor for yours."
            )
        return framebuffer

    def _checked(self, number: int) -> gl.Framebuffer:
        """A framebuffer that takes colours, bound."""
        ask = self._ask
        if number and not ask.exists(number):
            raise BadInputError(f"number {number} is not a framebuffer object of the OpenGL context.")
        ask.bind(number)
        if not ask.is_complete():
            what = "the framebuffer is incomplete" if number else "the OpenGL context has no window"
            raise BadInputError(f"{what}; give a framebuffer object with an RGBA8 texture.")
        if number and not (ask.has(COLOUR) and ask.has_blue(COLOUR) and not ask.has_whole_numbers(COLOUR)):
            raise BadInputError(
                "the framebuffer's first attachment does not hold red, green and blue as fractions; give it an RGBA8 "
                "texture."
            )
        if number not in self._by_number:
            self._by_number[number] = self._wrapped(number)
        ask.bind(number)
        return self._by_number[number]

    def _wrapped(self, number: int) -> gl.Framebuffer:
        with self._context.drawing() as ctx:
            found: Any = ctx.detect_framebuffer(number) if number else ctx.screen
        if found is None:
            raise BadInputError("the compositor's own OpenGL context has no window; give a framebuffer object of it.")
        if number and isinstance(found.color_mask[0], tuple):
            # Only the first colour is drawn to: what a shader leaves out is undefined.
            found.color_mask = (_ON, *[_OFF] * (len(found.color_mask) - 1))
        framebuffer: gl.Framebuffer = found
        return framebuffer


@dataclass(frozen=True, eq=False)
class GlComposed:
    """One eye's picture on the GPU; `warped` is None if it went into a framebuffer of the caller's."""

    warped: GpuWarped | None
    ray_maps: list[GpuRayMap]

    @property
    def texture(self) -> gl.Texture | None:
        """See `ComposedEye`."""
        return self.warped.colour if self.warped else None

    def read(self) -> WarpedImage:
        """See `ComposedEye`."""
        if self.warped is None:
            raise BadInputError("the picture was composed into your framebuffer; read that, or compose without `into`.")
        return self.warped.read()

    def unsolved(self) -> dict[str, int]:
        """See `ComposedEye`."""
        return count_unsolved(each.read_status() for each in self.ray_maps)

    def read_ray_maps(self) -> list[RayMap]:
        """See `ComposedEye`."""
        return [each.read() for each in self.ray_maps]


class GlEye:
    """One eye on the GPU."""

    def __init__(
        self,
        context: gl.GlContext,
        framebuffers: CallersFramebuffers,
        plan: EyePlan,
        solve: str,
        background: tuple[int, int, int],
    ) -> None:
        self._context, self._framebuffers = context, framebuffers
        self._plan, self._background = plan, background
        self._ray_maps = CachedRayMaps([_solve_of(context, mappings, plan, solve) for mappings in plan.channels])
        self._warp = GlWarp(context, len(plan.channels))
        self._import = PictureImport(context)
        self._picture: GpuImage | None = None

    def set_picture(self, color: Any, depth: Any, stored: StoredDepth, rows: Rows | None) -> None:
        """See `EyeBackend`."""
        self._picture = self._import_picture(color, depth, stored, rows)

    def _import_picture(self, color: Any, depth: Any, stored: StoredDepth, rows: Rows | None) -> GpuImage:
        camera, importer = self._plan.camera, self._import
        if isinstance(color, GpuImage):
            return checked_image(color, camera, self._context)
        if isinstance(color, np.ndarray) and isinstance(depth, np.ndarray):
            return importer.from_arrays(camera, color, depth, stored, rows or Rows.TOP_FIRST)
        if isinstance(color, gl.Texture) and isinstance(depth, gl.Texture):
            return importer.from_textures(camera, color, depth, stored, rows or Rows.BOTTOM_FIRST)
        if isinstance(color, gl.Framebuffer) and depth is None:
            return importer.from_framebuffer(camera, color, stored, rows or Rows.BOTTOM_FIRST)
        if isinstance(color, Integral) and depth is None:
            return importer.from_framebuffer(camera, int(color), stored, rows or Rows.BOTTOM_FIRST)
        raise BadInputError(
            f"a picture cannot be taken from a {type(color).__name__} and a {type(depth).__name__}; submit two arrays, "
            "two textures, or one framebuffer (or its number) that holds both colour and depth."
        )

    def compose(
        self, viewpoint: FloatArray, image_from_ray_map: FloatArray, target: WarpTarget | None, with_source: bool
    ) -> GlComposed:
        """See `EyeBackend`."""
        assert self._picture is not None, "the compositor checks that every eye is submitted"
        ray_maps = self._ray_maps.at(viewpoint)
        drawn = (self._picture, ray_maps, image_from_ray_map)
        if target is not None:
            with self._framebuffers.draw_buffers_kept(target.framebuffer):
                self._warp.draw_into(target, *drawn, self._background, self._plan.samples_per_axis)
            return GlComposed(None, ray_maps)
        warped = self._warp.draw(*drawn, self._plan.size_px, self._background, self._plan.samples_per_axis, with_source)
        return GlComposed(warped, ray_maps)

    def forget(self) -> None:
        """See `EyeBackend`."""
        self._ray_maps.forget()


class GlBackend:
    """All eyes in one context."""

    def __init__(self, context: Any, plans: Sequence[EyePlan], solve: str, background: tuple[int, int, int]) -> None:
        """Open or adopt the context, see `Compositor`.

        Raises:
            BadInputError: pixels for models that are not planar, or sizes that are too large.
            MissingGlError: no OpenGL, or a context that is too old.
        """
        self.context = _context(context)
        self.name = self.context.renderer
        self._framebuffers = CallersFramebuffers(self.context)
        try:
            for plan in plans:
                _check_sizes(plan, self.context.largest_side_px)
            self.eyes = {plan.eye: GlEye(self.context, self._framebuffers, plan, solve, background) for plan in plans}
        except BaseException:
            self.release()
            raise

    def working(self) -> AbstractContextManager[object]:
        """See `Backend`."""
        return self.context.drawing()

    def targets(self, into: Any, eyes: Sequence[str], size_px: tuple[int, int]) -> dict[str, WarpTarget]:
        """See `Backend`."""
        return {} if into is None else self._framebuffers.targets(into, eyes, size_px)

    def finish(self) -> None:
        """See `Backend`."""
        with self.context.drawing() as ctx:
            ctx.finish()

    def release(self) -> None:
        """See `Backend`; an adopted context stays open."""
        self.context.release()


def _check_sizes(plan: EyePlan, largest_px: int) -> None:
    for what, size in (("display", plan.size_px), ("camera", (plan.camera.width_px, plan.camera.height_px))):
        if max(size) > largest_px:
            raise BadInputError(
                f"the {plan.eye} eye's {what} would have {size[0]} x {size[1]} pixels, and OpenGL takes {largest_px} "
                "here; make size or resolution smaller."
            )


def _context(context: Any) -> gl.GlContext:
    if isinstance(context, str):
        return gl.adopt_context() if context == "current" else gl.open_context(context)
    if not isinstance(context, gl.Context):
        raise BadInputError(f"a {type(context).__name__} is not an OpenGL context; give a moderngl.Context, or a name.")
    return gl.adopt_context(context)


def _solve_of(context: gl.GlContext, mappings: EyeMappings, plan: EyePlan, solve: str) -> RayMapSolver[GpuRayMap]:
    planar = isinstance(mappings.display, PlanarDisplay) and isinstance(mappings.see_through, PlanarSeeThrough)
    axes = plan.device_from_camera
    if solve == "pixels" or (solve == "auto" and planar and not context.is_software):
        return GlPlanarSolver(context, mappings, WarpGrid.of_pixels(mappings.display.panel, plan.size_px), axes)
    warp_grid = plan.warp_grid.grid
    if planar:
        return GlPlanarSolver(context, mappings, warp_grid, axes)
    count = choose_plan(mappings).node_count
    return GlNodeSolver(context, mappings, RayMapPlan.onto_grid(warp_grid, count, axes))


def checked_image(image: GpuImage, camera: Pinhole, context: gl.GlContext) -> GpuImage:
    """An image of our own renderers, drawn in this context with the camera that was asked for.

    Raises:
        BadInputError: drawn with another camera, or elsewhere.
    """
    if image.context is not context:
        raise BadInputError("the picture was drawn in another context; make the renderer for `Compositor.context`.")
    if image.camera is not camera:
        raise BadInputError("the picture was drawn with another camera; draw with the one that begin_frame gave.")
    return image
