"""Draw panel images of one eye for a viewpoint and a head pose, by ray tracing or by raster and warp."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from wlr_render.geometry import transforms
from wlr_render.mappings import EyeChannels, EyeMappings
from wlr_render.numerics.arrays import Float32Array, FloatArray
from wlr_render.rendering.raster_backends import RasterBackend
from wlr_render.rendering.raster_camera import EyePlan, RasterPlace
from wlr_render.rendering.ray_map import RayMap, RayMapPlan, WarmStart, choose_plan, ray_map
from wlr_render.rendering.ray_tracing import RayRenderer
from wlr_render.rendering.sampling import remap
from wlr_render.rendering.srgb import encode_srgb
from wlr_render.rendering.view import GeometryImage, View


@dataclass(frozen=True, eq=False)
class Frame:
    """One eye's panel image.

    "Of each channel" means one for all colours, or one each for red, green and blue.

    Attributes:
        colour: (height, width, 3) uint8 sRGB; the scene's background where there is no ray.
        ray_maps: the world rays of each channel; `status` says why a pixel has none.
        warp_status: (height, width) uint8, one `WarpStatus` each, the worst of the channels; None for frames that were
            not met with a depth image.
        traced: of each channel (height, width, 3) float32, the world point that ray tracing found for each pixel, NaN
            where none; on request, empty for a frame that was not met with the mesh.
        sources: of each channel (height, width, 3) float32, the pull map of a warped frame: position (u, v) in the
            intermediate image and the inverse depth found there (1/m), NaN where none; on request, empty for a
            ray-traced frame.
        view, intermediate: the intermediate image of a warped frame and from where it was drawn; on request.
    """

    colour: NDArray[np.uint8]
    ray_maps: tuple[RayMap, ...]
    warp_status: NDArray[np.uint8] | None = None
    traced: tuple[Float32Array, ...] = ()
    sources: tuple[Float32Array, ...] = ()
    view: View | None = None
    intermediate: GeometryImage | None = None

    @property
    def ray_map(self) -> RayMap:
        """The only or the green channel's."""
        return self.ray_maps[len(self.ray_maps) // 2]

    @property
    def warm_start(self) -> "WarmStarts":
        """Warm start of the eye's next frame."""
        return tuple(each.warm_start for each in self.ray_maps)

    @property
    def source(self) -> Float32Array | None:
        """The only or the green channel's pull map."""
        return self.sources[len(self.sources) // 2] if self.sources else None

    @cached_property
    def position(self) -> Float32Array | None:
        """(height, width, 3) float32, the world point that each pixel shows (in green), NaN where none; on request."""
        if self.traced:
            return self.traced[len(self.traced) // 2]
        return None if self.view is None or self.source is None else position_of_source(self.view, self.source)


WarmStarts = tuple[WarmStart | None, ...]


class Painter(Protocol):
    """Renders the frames of one eye and scene."""

    def paint(
        self,
        viewpoint: FloatArray,
        world_from_device: FloatArray,
        warm_start: WarmStarts | None = None,
        with_geometry: bool = False,
    ) -> Frame:
        """Render one frame.

        Args:
            viewpoint: (3,) entrance pupil, device frame.
            world_from_device: (4, 4) head pose.
            warm_start: `Frame.warm_start` of this eye's last frame.
            with_geometry: also give what `Frame` has on request.
        """


def _channels(mappings: EyeMappings | Sequence[EyeMappings]) -> EyeChannels:
    return (mappings,) if isinstance(mappings, EyeMappings) else tuple(mappings)


def _by_colour(pictures: Sequence[NDArray[np.uint8]]) -> NDArray[np.uint8]:
    """The picture for all colours, or the red, green and blue of one picture each."""
    return pictures[0] if len(pictures) == 1 else np.stack([each[..., k] for k, each in enumerate(pictures)], axis=-1)


def _ray_maps(
    channels: EyeChannels, plans: Sequence[RayMapPlan], viewpoint: FloatArray, warm_start: WarmStarts | None
) -> tuple[RayMap, ...]:
    starts = warm_start or (None,) * len(channels)
    each = zip(channels, plans, starts, strict=True)
    return tuple(ray_map(mappings, viewpoint, plan, start) for mappings, plan, start in each)


class TracedPainter:
    """Every display pixel's world ray is a primary ray."""

    def __init__(
        self,
        mappings: EyeMappings | Sequence[EyeMappings],
        renderer: RayRenderer,
        supersample: int = 1,
        shadows: bool = False,
    ) -> None:
        """Prepare.

        Args:
            mappings: any pair, or one each for red, green and blue.
            renderer: of the scene.
            supersample: rays per pixel along each axis; geometry is always that of the pixel centre.
            shadows: whether surfaces cast shadows.
        """
        self._channels = _channels(mappings)
        self._renderer = renderer
        self._shadows = shadows
        self._plans = [choose_plan(each) for each in self._channels]
        self._sample_plans = [_sample_plans(plan, supersample) for plan in self._plans]

    def paint(
        self,
        viewpoint: FloatArray,
        world_from_device: FloatArray,
        warm_start: WarmStarts | None = None,
        with_geometry: bool = False,
    ) -> Frame:
        """See `Painter`."""
        ray_maps = _ray_maps(self._channels, self._plans, viewpoint, warm_start)
        colours, traced = [], []
        for mappings, rays, sample_plans in zip(self._channels, ray_maps, self._sample_plans, strict=True):
            if with_geometry or not sample_plans:
                buffers = ("position",) if with_geometry else ()
                rays_of = partial(rays.world_rays, world_from_device)
                image = self._renderer.render_blocks(rays.shape, rays_of, buffers, self._shadows)
                colour = image.colour
                if image.position is not None:
                    traced.append(image.position)
            if sample_plans:
                samples = (ray_map(mappings, viewpoint, plan, rays.warm_start) for plan in sample_plans)
                sampled = (partial(each.world_rays, world_from_device) for each in samples)
                colour = self._renderer.render_supersampled(rays.shape, sampled, self._shadows)
            colours.append(colour)
        return Frame(_by_colour(colours), ray_maps, traced=tuple(traced))


def _sample_plans(plan: RayMapPlan, supersample: int) -> list[RayMapPlan]:
    if supersample == 1:
        return []
    steps = (np.arange(supersample) + 0.5) / supersample - 0.5
    return [
        RayMapPlan.with_nodes(plan.panel, plan.node_count, plan.device_from_camera, np.array([u, v]))
        for v in steps
        for u in steps
    ]


class WarpedPainter:
    """Renders an intermediate image near the viewpoint and warps it to display pixels by a warp map per frame.

    The colours of an eye share it: its jagged edges must not fall differently in each.
    """

    def __init__(
        self,
        mappings: EyeMappings | Sequence[EyeMappings],
        raster_backend: RasterBackend,
        resolution: float = 1.0,
        raster_camera: RasterPlace = "nearest",
    ) -> None:
        """Prepare.

        Args:
            mappings: any pair, or one each for red, green and blue.
            raster_backend: of the scene.
            resolution: 1 gives the intermediate image about as many pixels as the display has, 2 four times as many.
            raster_camera: position of the camera of the intermediate image: "viewpoint", as in the paper, or "nearest"
                to the bent rays (`raster_camera.py`), from where fewer pixels are disoccluded.
        """
        self._channels = _channels(mappings)
        self._raster_backend = raster_backend
        panel = self._channels[0].display.panel
        self._plan = EyePlan.of(self._channels, (panel.width_px, panel.height_px), resolution, raster_camera)
        axes = self._plan.device_from_camera
        self._plans = [RayMapPlan.with_nodes(panel, choose_plan(each).node_count, axes) for each in self._channels]

    def view(self, viewpoint: FloatArray, world_from_device: FloatArray) -> View:
        """From where the intermediate image is drawn; its camera is the same for all viewpoints in the eye box."""
        return self._plan.view(viewpoint, world_from_device)

    def paint(
        self,
        viewpoint: FloatArray,
        world_from_device: FloatArray,
        warm_start: WarmStarts | None = None,
        with_geometry: bool = False,
    ) -> Frame:
        """See `Painter`."""
        ray_maps = _ray_maps(self._channels, self._plans, viewpoint, warm_start)
        view = self.view(viewpoint, world_from_device)
        warped = self._raster_backend.draw_warped(view, ray_maps, self._plan.samples_per_axis, with_geometry)
        image, intermediate = warped.image, warped.intermediate
        if intermediate is None:
            return Frame(image.colour, ray_maps, image.status)
        sources = tuple(with_inverse_depth(intermediate, source) for source in warped.sources)
        return Frame(image.colour, ray_maps, image.status, sources=sources, view=view, intermediate=intermediate)


class MeshWarpedPainter:
    """Like `WarpedPainter`, but the warp map comes from intersecting each world ray with the mesh.

    The paper's map (section 4.2). The map is right everywhere; where the intermediate image hides a point, its colour
    is that of what hides it. Colours are interpolated bilinearly, without the filter of `WarpedPainter`.
    """

    def __init__(
        self,
        mappings: EyeMappings | Sequence[EyeMappings],
        raster_backend: RasterBackend,
        renderer: RayRenderer,
        resolution: float = 1.0,
        raster_camera: RasterPlace = "nearest",
    ) -> None:
        """Prepare, as `WarpedPainter`; `renderer` is of the same scene."""
        self._plain = WarpedPainter(mappings, raster_backend, resolution, raster_camera)
        self._traced = TracedPainter(mappings, renderer)
        self._raster_backend = raster_backend
        self._background = encode_srgb(renderer.scene.background)

    def paint(
        self,
        viewpoint: FloatArray,
        world_from_device: FloatArray,
        warm_start: WarmStarts | None = None,
        with_geometry: bool = False,
    ) -> Frame:
        """See `Painter`."""
        traced = self._traced.paint(viewpoint, world_from_device, warm_start, with_geometry=True)
        view = self._plain.view(viewpoint, world_from_device)
        image = self._raster_backend.draw(view)
        sources = tuple(source_of_position(view, position) for position in traced.traced)
        colours = [remap(image.colour, source[..., :2], self._background)[0] for source in sources]
        colour = _by_colour([np.asarray(each, np.uint8) for each in colours])
        return Frame(colour, traced.ray_maps, traced=traced.traced, sources=sources, view=view, intermediate=image)


def raster_painter(
    mappings: EyeMappings | Sequence[EyeMappings],
    raster_backend: RasterBackend,
    renderer: RayRenderer | None,
    resolution: float = 1.0,
    raster_camera: RasterPlace = "nearest",
) -> Painter:
    """A `MeshWarpedPainter` with a renderer of the same scene; without, a `WarpedPainter`, which needs no mesh."""
    if renderer is None:
        return WarpedPainter(mappings, raster_backend, resolution, raster_camera)
    return MeshWarpedPainter(mappings, raster_backend, renderer, resolution, raster_camera)


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
