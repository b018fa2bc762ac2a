"""Compositor backend in OpenGL, on a GPU or a software renderer."""

import contextlib
import itertools
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from typing import Any, Literal

import numpy as np

from wlr_render.errors import BadInputError
from wlr_render.geometry.pinhole import Pinhole
from wlr_render.gl import gl
from wlr_render.gl.readback import ReadbackRing
from wlr_render.mappings import Eye, is_planar
from wlr_render.numerics.arrays import FloatArray
from wlr_render.warp.checks import checked_choice
from wlr_render.warp.composed_frame import CachedRayMaps, GlComposed
from wlr_render.warp.gl_overlay import Overlay, OverlayImport, Quad, SeenOverlay
from wlr_render.warp.gl_panel import TEXTURE_KINDS, PanelEncoder
from wlr_render.warp.gl_ray_maps import GlNodeSolver, GlPlanarSolver, GpuRayMap
from wlr_render.warp.gl_warp import Backdrop, GlWarp, GpuWarped, WarpedPicture, WarpTarget
from wlr_render.warp.gpu_image import GpuImage
from wlr_render.warp.panel_light import PanelLight
from wlr_render.warp.picture_import import PictureImport
from wlr_render.warp.raster_camera import EyePlan
from wlr_render.warp.ray_map import RayMapPlan, RayMapSolver, choose_plan
from wlr_render.warp.stored_picture import Rows, StoredColour, StoredDepth
from wlr_render.warp.target_framebuffers import TargetFramebuffers
from wlr_render.warp.view import View, image_from_ray_map

HostState = Literal["kept", "clean"]
"""Use of an adopted context, see `Compositor`."""

HiddenAreas = Literal["repeated", "last picture"]
"""Content of areas that edges hide from the newest picture, see `Compositor`."""

CONTEXTS = ("auto", "egl", "osmesa", "current")


class GlEye:
    """One eye on the GPU."""

    def __init__(
        self,
        context: gl.GlContext,
        plan: EyePlan,
        background: tuple[int, int, int],
        panel: PanelLight,
        keeps_last_picture: bool,
    ) -> None:
        self._context, self.size_px = context, plan.size_px
        self._plan, self._background = plan, background
        channels = plan.channels if panel.sub_pixel_px is None or len(plan.channels) == 3 else 3 * plan.channels
        offsets_px = np.zeros((len(channels), 2)) if panel.sub_pixel_px is None else panel.sub_pixel_px
        self._ray_maps = CachedRayMaps(
            [_solve_of(context, *each, plan) for each in zip(channels, offsets_px, strict=True)]
        )
        self._encoder = PanelEncoder.of(context, panel)
        self._warp = GlWarp(context, len(channels), self._encoder)
        self._warp_of_sources = GlWarp(context, len(channels), self._encoder)  # draws pull maps of red and blue
        self._readbacks = ReadbackRing(context)
        # Two sets of textures take pictures in turn if the last picture is kept.
        self._imports = [PictureImport(context) for _ in range(1 + keeps_last_picture)]
        self._keeps_last_picture = keeps_last_picture
        self._pictures: list[WarpedPicture] = []  # widest first
        self._view: View | None = None  # view of the newest picture
        self._last: tuple[WarpedPicture, View] | None = None  # the picture before it, if it is kept
        self._import_insets: list[PictureImport] = []
        self._import_overlays: dict[int, OverlayImport] = {}
        self._overlays: dict[int, Overlay] = {}
        self.generation = 0
        """Number of pictures composed; each overwrites the one before."""

    def set_picture(
        self, view: View, colour: Any, depth: Any, stored: StoredDepth, rows: Rows | None, stored_colour: StoredColour
    ) -> None:
        """Replace the eye's picture, see `Compositor.submit`; after an error the last picture stays."""
        if isinstance(colour, GpuImage):
            image = checked_image(colour, view, self._context)
        else:
            image = self._imports[-1].take(view.camera, colour, depth, stored, rows, stored_colour)
            self._imports = self._imports[::-1]
        if self._keeps_last_picture and self._view is not None:
            self._last = self._pictures[0], self._view
        self._view = view
        self._pictures = [WarpedPicture(image, self._plan.samples_per_axis)]

    def is_drawn_whole(self, view: View) -> bool:
        """Return whether a view shows the eye's whole picture, not an inset."""
        return view.camera is self._plan.camera

    @property
    def sharpest(self) -> Pinhole:
        """Camera of the picture that was submitted last, which contains the next inset."""
        return self._pictures[-1].image.camera

    def add_inset(
        self, view: View, colour: Any, depth: Any, stored: StoredDepth, rows: Rows | None, stored_colour: StoredColour
    ) -> None:
        """Add a picture of `Compositor.submit(camera=...)`, which lies within the last one."""
        self.check_picture()
        wider = self._pictures[-1].image
        if isinstance(colour, GpuImage):
            checked_image(colour, view, self._context)
        has_alpha = colour.has_alpha if isinstance(colour, GpuImage) else stored_colour.alpha
        if has_alpha != wider.has_alpha:
            raise BadInputError("an inset has alpha if and only if the picture around it has; submit both with alpha.")
        _check_side(f"the {self._plan.eye} eye's inset", view.camera.size_px, self._context.largest_side_px, "size_px")
        count = len(self._pictures)
        if len(self._import_insets) < count:
            self._import_insets.append(PictureImport(self._context))
        take = self._import_insets[count - 1].take
        image = take(view.camera, colour, depth, stored, rows, stored_colour, wider)
        self._pictures.append(WarpedPicture(image, self._plan.samples_of(view.camera)))

    def forget(self) -> None:
        """Compute all again in the next frame."""
        self._ray_maps.forget()
        self._warp.forget()

    def check_picture(self) -> None:
        """Check the picture that the eye shows.

        Raises:
            BadInputError: its renderer has overwritten it.
        """
        if self._pictures and self._pictures[0].image.is_overwritten():
            raise BadInputError(
                f"the {self._plan.eye} eye's picture has been drawn over since it was submitted; submit the new one, "
                "or draw under two names in turn."
            )

    def set_overlay(
        self, layer: int, picture: Any, quad: Quad | None, stored_colour: StoredColour, rows: Rows | None
    ) -> None:
        """Replace or remove an overlay, see `Compositor.submit_overlay`; after an error the last overlay stays."""
        if quad is None:
            self._overlays.pop(layer, None)
            return
        if layer not in self._import_overlays:
            self._import_overlays[layer] = OverlayImport(self._context)
        self._overlays[layer] = self._import_overlays[layer].take(picture, quad, stored_colour, rows)

    def seen_overlays(self, view: View, world_from_device: FloatArray) -> list[SeenOverlay]:
        """Return the overlays that a view sees, for a head pose (4, 4), in drawing order."""
        seen = []
        for _, overlay in sorted(self._overlays.items()):
            place_of_ray = overlay.quad.place_of_ray(view, world_from_device)
            if place_of_ray is not None:
                seen.append(SeenOverlay(overlay.texture, place_of_ray))
        return seen

    def compose(
        self,
        viewpoint: FloatArray,
        world_from_device: FloatArray,
        world_from_device_by_row: FloatArray,
        target: WarpTarget | None,
        with_source: bool,
    ) -> GlComposed:
        """Return the picture for a viewpoint (3,) and a head pose (4, 4), into a target of `targets`.

        The poses by row are (4, 4) for all rows, or (grid rows, 4, 4).
        """
        assert self._view is not None, "the compositor checks that the eye is submitted"
        self.generation += 1
        self._context.dispatches.next_eye()

        def seen_from(view: View) -> tuple[FloatArray, list[SeenOverlay]]:
            moved = image_from_ray_map(view, viewpoint, self._plan.device_from_camera, world_from_device_by_row)
            return moved, self.seen_overlays(view, world_from_device)

        backdrop = None
        if self._last is not None:
            (last, last_view), has_alpha = self._last, self._pictures[0].image.has_alpha
            if not last.image.is_overwritten() and last.image.has_alpha == has_alpha:
                backdrop = Backdrop(last, *seen_from(last_view))
        moved, overlays = seen_from(self._view)
        return self._composed(self._pictures, viewpoint, moved, target, with_source, overlays, backdrop)

    def prepare(self, framebuffer: gl.Framebuffer, overlays: int, insets: bool) -> None:
        """Draw once in every mode, which compiles the shaders; see `Compositor.prepare`."""
        plan = self._plan
        size = plan.camera.width_px, plan.camera.height_px
        image = GpuImage(
            self._context, plan.camera, self._context.target(size, 4, "srgb"), self._context.target(size, 1, "f4")
        )
        picture, at = WarpedPicture(image, plan.samples_per_axis), plan.channels[0].eye_box.centre
        if overlays:
            OverlayImport(self._context)
        if insets:
            self._imports[0].inset_program()
        overlay = SeenOverlay(image.colour, np.eye(3))
        for target, pictures, over in itertools.product(
            (None, WarpTarget(framebuffer, (0, 0), plan.size_px, False)),
            ([picture], [picture, WarpedPicture(image, 2)])[: 1 + insets],
            ([], [overlay])[: 1 + bool(overlays)],
        ):
            backdrop = Backdrop(picture, np.eye(4), over) if self._keeps_last_picture else None
            self._composed(pictures, at, np.eye(4), target, False, over, backdrop)
        self.generation += 1

    def _composed(
        self,
        pictures: Sequence[WarpedPicture],
        viewpoint: FloatArray,
        image_from_ray_map: FloatArray,
        target: WarpTarget | None,
        with_source: bool,
        overlays: Sequence[SeenOverlay],
        backdrop: Backdrop | None = None,
    ) -> GlComposed:
        ray_maps, (widest, *insets) = self._ray_maps.at(viewpoint), pictures
        drawn, settings = (widest.image, ray_maps, image_from_ray_map), (self._background, widest.samples_per_axis)
        if target is not None:
            self._warp.draw_into(target, *drawn, *settings, overlays, insets, backdrop)
            return GlComposed(None, ray_maps, self._readbacks)
        size_px = self._plan.size_px
        warped = self._warp.draw(*drawn, size_px, *settings, with_source, overlays, insets, backdrop)
        if not with_source or len(ray_maps) == 1:
            return GlComposed(warped, ray_maps, self._readbacks)

        def draw_source(channel: int) -> GpuWarped:
            if self._pictures is not pictures or widest.image.is_overwritten():
                raise BadInputError(
                    f"the {self._plan.eye} eye's picture, from which the pull maps of red and blue are drawn, was "
                    "replaced after this frame was composed; read them before the next submit."
                )
            # The three-channel program already exists, and writes the pull map of the middle channel.
            of_channel = widest.image, [ray_maps[channel]] * len(ray_maps), image_from_ray_map
            return self._warp_of_sources.draw(*of_channel, size_px, *settings, True, (), insets, backdrop)

        return GlComposed(warped, ray_maps, self._readbacks, draw_source)


class GlBackend:
    """All eyes in one context."""

    def __init__(
        self,
        context: Any,
        host_state: HostState,
        plans: Sequence[EyePlan],
        background: tuple[int, int, int],
        panels: Mapping[str, PanelLight],
        keeps_last_pictures: bool,
    ) -> None:
        """Open, adopt or share the context, see `Compositor`.

        Raises:
            BadInputError: sizes that are too large.
            MissingGlError: no OpenGL, or a context that is too old.
        """
        self.context = _context(context, host_state == "clean")
        self.is_shared = isinstance(context, gl.GlContext)
        self.name = self.context.renderer
        self._framebuffers = TargetFramebuffers(
            self.context, TEXTURE_KINDS[max(panel.bits for panel in panels.values())]
        )
        try:
            for plan in plans:
                _check_sizes(plan, self.context.largest_side_px)
            self.eyes = {
                plan.eye: GlEye(self.context, plan, background, panels[plan.eye], keeps_last_pictures) for plan in plans
            }
        except BaseException:
            self.release()
            raise

    def working(self) -> AbstractContextManager[object]:
        """Return a block in which the backend may be called."""
        return self.context.working()

    def together(self) -> AbstractContextManager[object]:
        """Return a block in which several eyes are composed, by one dispatch of each shader if the context computes."""
        return self._together() if self.context.computes else contextlib.nullcontext()

    @contextlib.contextmanager
    def _together(self) -> Iterator[None]:
        try:
            with self.context.dispatches.together():
                yield
        except BaseException:
            for eye in self.eyes.values():
                eye.forget()  # the error has dropped dispatches that the eye takes for done
            raise

    @contextlib.contextmanager
    def reading(self, eye: str, generation: int) -> Iterator[None]:
        """Open a block in which an eye's picture of a generation is read, while no other thread composes.

        Raises:
            BadInputError: a later picture has overwritten it.
        """
        with self.working():
            if self.eyes[eye].generation != generation:
                raise BadInputError(
                    f"a later compose has overwritten this picture of the {eye} eye; read a frame before the next."
                )
            yield

    def show(self, targets: Mapping[str, WarpTarget]) -> None:
        """Copy the picture for a window to the window, if it is one of the targets."""
        self._framebuffers.show(targets.values())

    def targets(self, into: Any, eyes: Sequence[str], size_px: tuple[int, int]) -> dict[str, WarpTarget]:
        """Return the target of each eye's picture; empty for the compositor's textures; see `Compositor.compose`."""
        return {} if into is None else self._framebuffers.targets(into, eyes, size_px)

    def prepare(self, overlays: int, insets: bool) -> None:
        """Compile all shaders; see `Compositor.prepare`."""
        with self.context.drawing():
            for eye in self.eyes.values():
                eye.prepare(self.context.framebuffer([self.context.target(eye.size_px, 4, "f1")]), overlays, insets)

    def finish(self) -> None:
        """Block until the GPU is idle."""
        with self.context.drawing() as ctx:
            ctx.finish()

    def release(self) -> bool:
        """Free all objects, and return whether that was possible; an adopted or shared context stays open."""
        return self.is_shared or self.context.release()


def _check_sizes(plan: EyePlan, largest_px: int) -> None:
    for what, size in (("display", plan.size_px), ("camera", plan.camera.size_px)):
        _check_side(f"the {plan.eye} eye's {what}", size, largest_px, "size or resolution")


def _check_side(what: str, size: tuple[int, int], largest_px: int, made_smaller: str) -> None:
    if max(size) > largest_px:
        raise BadInputError(
            f"{what} would have {size[0]} x {size[1]} pixels, and OpenGL takes {largest_px} here; make {made_smaller} "
            "smaller."
        )


def _context(context: Any, host_is_clean: bool) -> gl.GlContext:
    if isinstance(context, gl.GlContext):
        return context
    if isinstance(context, str) and context == "cpu":
        raise BadInputError(
            "A compositor needs OpenGL; give context='auto', or draw ray-traced frames (TracedPainter, or `render "
            "--backend cpu`)."
        )
    if isinstance(context, str) and checked_choice(context, CONTEXTS, "context") != "current":
        if host_is_clean:
            raise BadInputError(
                f"host_state='clean' is of an adopted context, and context={context!r} opens one of our own, which has "
                "no host; leave host_state out, or give context='current' or yours."
            )
        return gl.open_context(context)
    if not isinstance(context, gl.Context | str):
        raise BadInputError(
            f"a {type(context).__name__} is not an OpenGL context; give a moderngl.Context, a gl.gl.GlContext, "
            f"or one of {', '.join(CONTEXTS)}."
        )
    return gl.adopt_context(None if isinstance(context, str) else context, host_is_clean)


def _solve_of(context: gl.GlContext, mappings: Eye, offset_px: FloatArray, plan: EyePlan) -> RayMapSolver[GpuRayMap]:
    """Return the solver for a primary with sub-pixels offset (2,) display pixels from the pixel centres."""
    warp_grid, axes = plan.warp_grid.grid, plan.device_from_camera
    warp_grid = replace(warp_grid, first_px=warp_grid.first_px + offset_px * warp_grid.panel.size_px / plan.size_px)
    if is_planar(mappings):
        return GlPlanarSolver(context, mappings, warp_grid, axes)
    count = choose_plan(mappings).node_count
    return GlNodeSolver(context, mappings, RayMapPlan.onto_grid(warp_grid, count, axes))


def checked_image(image: GpuImage, view: View, context: gl.GlContext) -> GpuImage:
    """Return an image of this library's renderers, if it was drawn in this context from the requested view.

    Raises:
        BadInputError: the image was drawn with another camera, for another pose, or in another context.
    """
    if image.context is not context:
        raise BadInputError("the picture was drawn in another context; make the renderer for `Compositor.context`.")
    if image.camera is not view.camera:
        raise BadInputError("the picture was drawn with another camera; draw with the one that begin_frame gave.")
    if image.is_overwritten():
        raise BadInputError("the picture has been drawn over; submit it before you draw another under its name.")
    if image.view is not None and not np.array_equal(image.view.world_from_camera, view.world_from_camera):
        raise BadInputError(
            "the picture was drawn for another pose; draw it with the camera of its frame, and submit it with that "
            "frame's handle."
        )
    return image
