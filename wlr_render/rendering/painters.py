"""Frames of one eye: what its panel must show for a viewpoint and a head pose, by ray tracing or by raster and warp."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from wlr_render.geometry import transforms
from wlr_render.mappings import EyeMappings
from wlr_render.numerics.arrays import Float32Array, FloatArray
from wlr_render.rendering.raster_backends import Rasteriser
from wlr_render.rendering.raster_camera import RasterEye, covering_camera, shrink_over_eye_box, taps_for
from wlr_render.rendering.ray_map import FieldPlan, RayField, WarmStart, choose_plan, middle_axes, ray_field
from wlr_render.rendering.ray_tracing import RayRenderer
from wlr_render.rendering.sampling import remap
from wlr_render.rendering.srgb import encode_srgb
from wlr_render.rendering.view import GeometryImage, View


@dataclass(frozen=True, eq=False)
class Frame:
    """What one eye's panel must show.

    Attributes:
        colour: (height, width, 3) uint8 sRGB; the scene's background where there is no ray.
        field: the world rays; `field.status` says why a pixel has none, `field.warm_start` starts the next frame.
        warp_status: (height, width) uint8, one `WarpStatus` each; None for frames that were not met with a depth image.
        position: (height, width, 3) float32, the world point that each pixel shows, NaN where none; on request.
        source: (height, width, 3) float32, the pull map of a warped frame: position (u, v) in the intermediate image
            and the inverse depth found there (1/m), NaN where none; on request, None for a ray-traced frame.
        view, intermediate: the intermediate image of a warped frame and from where it was drawn; on request.
    """

    colour: NDArray[np.uint8]
    field: RayField
    warp_status: NDArray[np.uint8] | None = None
    position: Float32Array | None = None
    source: Float32Array | None = None
    view: View | None = None
    intermediate: GeometryImage | None = None


def colour_by_colour(frames: Sequence[Frame]) -> NDArray[np.uint8]:
    """What the panel must show, (height, width, 3): of three frames the red, green and blue of one each; of one all."""
    if len(frames) == 1:
        return frames[0].colour
    return np.stack([frame.colour[..., channel] for channel, frame in enumerate(frames)], axis=-1)


class Painter(Protocol):
    """Makes the frames of one eye, scene and way of drawing."""

    def paint(
        self,
        viewpoint: FloatArray,
        world_from_device: FloatArray,
        warm_start: WarmStart | None = None,
        with_geometry: bool = False,
    ) -> Frame:
        """One frame.

        Args:
            viewpoint: (3,) entrance pupil, device frame.
            world_from_device: (4, 4) head pose.
            warm_start: `frame.field.warm_start` of this eye's last frame.
            with_geometry: also give what `Frame` has on request.
        """


class TracedPainter:
    """Every display pixel's world ray is a primary ray."""

    def __init__(
        self, mappings: EyeMappings, renderer: RayRenderer, supersample: int = 1, shadows: bool = False
    ) -> None:
        """Prepare.

        Args:
            mappings: any pair.
            renderer: of the scene.
            supersample: rays per pixel along each axis; geometry is always that of the pixel centre.
            shadows: whether surfaces cast shadows.
        """
        self._mappings = mappings
        self._renderer = renderer
        self._shadows = shadows
        self._plan = choose_plan(mappings)
        self._sample_plans = _sample_plans(self._plan, supersample)

    def paint(
        self,
        viewpoint: FloatArray,
        world_from_device: FloatArray,
        warm_start: WarmStart | None = None,
        with_geometry: bool = False,
    ) -> Frame:
        """See `Painter`."""
        field = ray_field(self._mappings, viewpoint, self._plan, warm_start)
        image = None
        if with_geometry or not self._sample_plans:
            buffers = ("position",) if with_geometry else ()
            image = self._renderer.render_blocks(
                field.shape, lambda rows: field.world_rays(world_from_device, rows), buffers, self._shadows
            )
        if not self._sample_plans:
            assert image is not None
            return Frame(image.colour, field, position=image.position)
        fields = (ray_field(self._mappings, viewpoint, plan, field.warm_start) for plan in self._sample_plans)
        samples = ((lambda rows, f=f: f.world_rays(world_from_device, rows)) for f in fields)
        colour = self._renderer.render_supersampled(field.shape, samples, self._shadows)
        return Frame(colour, field, position=image.position if image is not None else None)


def _sample_plans(plan: FieldPlan, supersample: int) -> list[FieldPlan]:
    if supersample == 1:
        return []
    steps = (np.arange(supersample) + 0.5) / supersample - 0.5
    return [
        FieldPlan.with_nodes(plan.panel, plan.node_pixel.shape[0], plan.device_from_camera, np.array([u, v]))
        for v in steps
        for u in steps
    ]


class WarpedPainter:
    """An intermediate image from about the viewpoint, pulled into display pixels by the per-frame warp map."""

    def __init__(
        self,
        mappings: EyeMappings,
        rasteriser: Rasteriser,
        resolution: float = 1.0,
        at_viewpoint: bool = False,
        colours: Sequence[EyeMappings] | None = None,
    ) -> None:
        """Prepare.

        Args:
            mappings: any pair.
            rasteriser: of the scene.
            resolution: 1 gives the intermediate image about as many pixels as the display has, 2 four times as many.
            at_viewpoint: draw the intermediate image from the viewpoint itself, as the paper does, and not from where
                the bent rays come (`raster_camera.py`), from where less is hidden.
            colours: red, green and blue of the eye, if `mappings` are one of them: their painters then draw the same
                intermediate image, whose jagged edges must not fall differently in each colour.
        """
        self._mappings = mappings
        self._rasteriser = rasteriser
        self._plan = choose_plan(mappings)
        colours = colours or (mappings,)
        middle = colours[len(colours) // 2]
        self._device_from_camera = middle_axes(middle)
        self._camera = covering_camera(colours, self._device_from_camera, resolution)
        self._raster_eye = None if at_viewpoint else RasterEye(middle, self._device_from_camera)
        panel = middle.display.panel
        size_px = panel.width_px, panel.height_px
        self._taps = taps_for(shrink_over_eye_box(middle, self._device_from_camera, self._camera, size_px))

    def view(self, viewpoint: FloatArray, world_from_device: FloatArray) -> View:
        """From where the intermediate image is drawn; its camera is the same for all viewpoints in the eye box."""
        place = viewpoint if self._raster_eye is None else self._raster_eye.at(viewpoint)
        return View(self._camera, place, world_from_device, self._device_from_camera)

    def paint(
        self,
        viewpoint: FloatArray,
        world_from_device: FloatArray,
        warm_start: WarmStart | None = None,
        with_geometry: bool = False,
    ) -> Frame:
        """See `Painter`."""
        field = ray_field(self._mappings, viewpoint, self._plan, warm_start)
        view = self.view(viewpoint, world_from_device)
        warped = self._rasteriser.draw_warped(view, field, self._taps, with_geometry)
        frame = Frame(warped.image.colour, field, warped.image.status)
        if warped.intermediate is None or warped.image.source is None:
            return frame
        source = with_inverse_depth(warped.intermediate, warped.image.source)
        position = position_of_source(view, source)
        return replace(frame, position=position, source=source, view=view, intermediate=warped.intermediate)


class MeshWarpedPainter:
    """As `WarpedPainter`, but the warp map comes from the mesh: Embree meets each world ray with the scene itself.

    The map is right everywhere; where the intermediate image hides a point, its colour is that of what hides it.
    """

    def __init__(
        self,
        mappings: EyeMappings,
        rasteriser: Rasteriser,
        renderer: RayRenderer,
        resolution: float = 1.0,
        colours: Sequence[EyeMappings] | None = None,
    ) -> None:
        """Prepare, as `WarpedPainter`; `renderer` is of the same scene."""
        self._plain = WarpedPainter(mappings, rasteriser, resolution, colours=colours)
        self._traced = TracedPainter(mappings, renderer)
        self._rasteriser = rasteriser
        self._background = encode_srgb(renderer.scene.background)

    def paint(
        self,
        viewpoint: FloatArray,
        world_from_device: FloatArray,
        warm_start: WarmStart | None = None,
        with_geometry: bool = False,
    ) -> Frame:
        """See `Painter`."""
        traced = self._traced.paint(viewpoint, world_from_device, warm_start, with_geometry=True)
        assert traced.position is not None
        view = self._plain.view(viewpoint, world_from_device)
        intermediate = self._rasteriser.draw(view)
        source = source_of_position(view, traced.position)
        colour, _ = remap(intermediate.colour, source[..., :2], self._background)
        return replace(traced, colour=np.asarray(colour, np.uint8), source=source, view=view, intermediate=intermediate)


def source_of_position(view: View, position: Float32Array) -> Float32Array:
    """World points (height, width, 3) -> where the view's camera sees them and their inverse depth; NaN stays NaN."""
    in_camera = transforms.apply(transforms.inverse(view.world_from_camera), position.astype(np.float64))
    inverse = -1.0 / in_camera[..., 2]
    pixel = view.camera.pixel_of_tangents(in_camera[..., :2] * inverse[..., None])
    return np.concatenate([pixel, inverse[..., None]], axis=-1).astype(np.float32)


def with_inverse_depth(intermediate: GeometryImage, source: Float32Array) -> Float32Array:
    """Pull map (height, width, 2) -> (height, width, 3) with the inverse depth found at the source."""
    from wlr_render.rendering.cpu_warp import inverse_depth_at

    found = np.isfinite(source[..., 0])
    depth = np.full(source.shape[:2], np.nan, np.float32)
    depth[found] = inverse_depth_at(intermediate.inverse_depth, source[found])
    return np.concatenate([source, depth[..., None]], axis=-1)


def position_of_source(view: View, source: Float32Array) -> Float32Array:
    """World points (height, width, 3) that a pull map with inverse depths shows; NaN where there is none."""
    inverse = np.where(source[..., 2] > 0, source[..., 2], np.nan).astype(np.float64)
    tangents = view.camera.tangents_of_pixel(source[..., :2].astype(np.float64))
    in_camera = np.concatenate([tangents, -np.ones((*inverse.shape, 1))], axis=-1) / inverse[..., None]
    return transforms.apply(view.world_from_camera, in_camera).astype(np.float32)
