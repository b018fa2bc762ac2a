"""Panel images of one eye for a viewpoint and a head pose, by ray tracing; `raster_painter.py` rasterises."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from wlr_render.draw.ray_tracing import RayRenderer
from wlr_render.draw.sampling import bilinear_at
from wlr_render.geometry import transforms
from wlr_render.mappings import Eye, EyeChannels, middle_channel
from wlr_render.numerics.arrays import Float32Array, FloatArray
from wlr_render.scene.image_files import write_png
from wlr_render.scene.scene import Scene
from wlr_render.warp.ray_map import RayMap, RayMapPlan, choose_plan, ray_map
from wlr_render.warp.view import GeometryImage, View
from wlr_render.warp.warp import SURFACE_STEP

RESOLUTION = 2.75
"""Default resolution of the intermediate image of offline frames. The image covers more than the panel's field of view:
North Star's has 4 pixels to a pixel of the panel."""
SUPERSAMPLE = 2
"""Default rays per pixel along each axis where a ray-traced pixel differs from a neighbour."""

_WHITE = 255
_SATURATED = 0.01  # smallest share of saturated pixels for a warning; a smaller one is highlights


@dataclass(frozen=True, eq=False)
class Frame:
    """The image of one eye's panel, from `render`; `save` writes it as a PNG.

    "Per channel" means one for all colours, or one each for red, green and blue.

    Attributes:
        make_colour: returns `colour`; it may wait for the GPU, or trace further rays.
        solve_ray_maps: returns the ray map of each channel; see `ray_maps`.
        traced: per channel (height, width, 3) float32, the world point that ray tracing found for each pixel, else NaN;
            on request, empty for a warped frame.
        sources: per channel (height, width, 3) float32, the pull map of a warped frame: position (u, v) in the
            intermediate image and the inverse depth found there (1/m), else NaN; on request, empty for a ray-traced
            frame.
        view, intermediate: the view and the intermediate image of a warped frame; on request.
    """

    make_colour: Callable[[], NDArray[np.uint8]]
    solve_ray_maps: Callable[[], tuple[RayMap, ...]]
    traced: tuple[Float32Array, ...] = ()
    sources: tuple[Float32Array, ...] = ()
    view: View | None = None
    intermediate: GeometryImage | None = None

    @cached_property
    def colour(self) -> NDArray[np.uint8]:
        """(height, width, 3) uint8 sRGB; the scene's background in pixels without a ray."""
        return self.make_colour()

    def save(self, path: str | Path) -> Path:
        """Write the image as an 8-bit PNG.

        Raises:
            BadInputError: a file that cannot be written.
        """
        return write_png(path, self.colour)

    @cached_property
    def ray_maps(self) -> tuple[RayMap, ...]:
        """World rays of each channel, solved at all pixels on first use; `status` says why a pixel has no ray."""
        return self.solve_ray_maps()

    @property
    def ray_map(self) -> RayMap:
        """Ray map of the only channel or of green."""
        return middle_channel(self.ray_maps)

    @property
    def source(self) -> Float32Array | None:
        """Pull map of the only channel or of green."""
        return middle_channel(self.sources) if self.sources else None

    @cached_property
    def position(self) -> Float32Array | None:
        """World points (height, width, 3) float32 that the pixels show (in green), else NaN; on request."""
        if self.traced:
            return middle_channel(self.traced)
        return None if self.view is None or self.source is None else position_of_source(self.view, self.source)


def is_blank(colour: NDArray[np.uint8]) -> bool:
    """Return whether all pixels of a frame (height, width, 3) have one colour: no edge of the scene is visible."""
    flat = colour.reshape(-1)
    return bool((flat[3:] == flat[:-3]).all())  # 30 times as fast as comparing with one pixel


def blank_warnings(names: Sequence[str], scene: str, device: Sequence[float] = (0, 0, 0)) -> list[str]:
    """Return a sentence if there are frames that show nothing of a scene, given their names.

    `device` (3,) is the place of the headset in the first one, in the world.
    """
    if not names:
        return []
    which = names[0] if len(names) == 1 else f"{len(names)} frames, {names[0]} the first,"
    return [
        f"{which} {'shows' if len(names) == 1 else 'show'} nothing of the scene '{scene}', or one even surface: every "
        f"pixel has the same colour. The headset is at ({', '.join(f'{each:.2f}' for each in device)}) m; place the "
        "scene within its field of view, in metres, with light on it."
    ]


def saturation_warnings(scene: Scene, frames: Iterable[NDArray[np.uint8]]) -> list[str]:
    """Return a sentence if lights of a scene saturate part of a frame; frames are drawn only if a light may do so."""
    lights = scene.bright_lights()
    share = max((float(np.mean((frame == _WHITE).any(axis=-1))) for frame in frames if lights), default=0.0)
    if share < _SATURATED:
        return []
    named = ", ".join(f"'{name}' ({brightness:.3g} times)" for name, brightness in lights.items())
    return [
        f"{share:.0%} of the pixels of a frame are saturated. Lights of the scene '{scene.name}' that make a white "
        f"surface brighter than white: {named}. State 'exposure' in a scene file, such as exposure = "
        f"{1 / max(lights.values()):.2g}; 0.00146 undoes the units of Blender's exporter (scenes/README.md)."
    ]


class Painter(Protocol):
    """Renders the frames of one eye and scene."""

    def paint(
        self,
        viewpoint: FloatArray,
        world_from_device: FloatArray,
        with_geometry: bool = False,
    ) -> Frame:
        """Render one frame.

        Args:
            viewpoint: (3,) entrance pupil, device frame.
            world_from_device: (4, 4) head pose.
            with_geometry: also return the attributes that `Frame` has on request.
        """


def channels_of(mappings: Eye | Sequence[Eye]) -> EyeChannels:
    """Return one pair of mappings, or one each for red, green and blue, as a tuple."""
    return (mappings,) if isinstance(mappings, Eye) else tuple(mappings)


def by_colour(pictures: Sequence[NDArray[np.uint8]]) -> NDArray[np.uint8]:
    """Return the one picture for all colours, or combine red, green and blue from one picture each."""
    return pictures[0] if len(pictures) == 1 else np.stack([each[..., k] for k, each in enumerate(pictures)], axis=-1)


def ray_maps_of(channels: EyeChannels, plans: Sequence[RayMapPlan], viewpoint: FloatArray) -> tuple[RayMap, ...]:
    """Return the ray map of each channel at a viewpoint (3,)."""
    return tuple(ray_map(mappings, viewpoint, plan) for mappings, plan in zip(channels, plans, strict=True))


def ray_maps_between_pixels(
    mappings: Eye, plan: RayMapPlan, rays: RayMap, offsets_px: Iterable[FloatArray]
) -> Iterator[RayMap]:
    """Yield ray maps at offsets (2,) from the pixel centres, at the viewpoint of `rays`, the centres' ray map."""
    for offset_px in offsets_px:
        moved = RayMapPlan.with_nodes(plan.panel, plan.node_count, plan.device_from_camera, offset_px)
        yield ray_map(mappings, rays.viewpoint_in_device, moved, rays.warm_start)


def rays_within_pixels(rays: RayMap, pixel: NDArray[np.intp], offsets_px: FloatArray) -> RayMap:
    """Return the ray map (n, count) at offsets (count, 2) from the centres of pixels (n,), numbered row by row.

    Rays are linear between neighbouring pixels; next to a pixel without a ray, all equal the centre's.
    """
    (height, width), flat = rays.shape, rays.slope_offset.reshape(4, -1)
    row, column = np.divmod(pixel, width)
    moved = flat[:, pixel, None]
    for place, size, step, along in ((column, width, 1, 0), (row, height, width, 1)):
        before, after = np.minimum(place, 1), np.minimum(size - 1 - place, 1)
        change = flat[:, pixel + step * after] - flat[:, pixel - step * before]
        change /= np.maximum(before + after, 1).astype(np.float32)
        moved = moved + np.nan_to_num(change)[..., None] * offsets_px[:, along].astype(np.float32)
    return replace(rays, slope_offset=moved, status=rays.status[row, column, None])


class TracedPainter:
    """A `Painter` of ray-traced frames: the world ray of every display pixel is a primary ray."""

    def __init__(
        self,
        mappings: Eye | Sequence[Eye],
        renderer: RayRenderer,
        supersample: int = 1,
        shadows: bool = False,
    ) -> None:
        """Prepare.

        Args:
            mappings: one pair for all colours, or one each for red, green and blue.
            renderer: renderer of the scene.
            supersample: rays per pixel along each axis where a pixel differs from its neighbours, else one. Geometry is
                always sampled at the pixel centre.
            shadows: whether surfaces cast shadows.
        """
        self._channels = channels_of(mappings)
        self._renderer = renderer
        self._shadows = shadows
        self._plans = [choose_plan(each) for each in self._channels]
        steps = (np.arange(supersample) + 0.5) / supersample - 0.5
        self._offsets = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)

    def paint(
        self,
        viewpoint: FloatArray,
        world_from_device: FloatArray,
        with_geometry: bool = False,
    ) -> Frame:
        """Return a ray-traced frame; more than one ray per pixel is traced only when its colour is first used."""
        ray_maps = ray_maps_of(self._channels, self._plans, viewpoint)
        colours, traced = [], []
        for rays in ray_maps:
            rays_of = partial(rays.world_rays, world_from_device)
            image = self._renderer.render_blocks(rays.shape, rays_of, with_geometry, self._shadows)
            if image.position is not None:
                traced.append(image.position)
            colours.append(image.colour)

        def make_colour() -> NDArray[np.uint8]:
            for colour, rays in zip(colours, ray_maps, strict=True):
                self._refine(colour, rays, world_from_device)
            return by_colour(colours)

        return Frame(make_colour, lambda: ray_maps, traced=tuple(traced))

    def _refine(self, colour: NDArray[np.uint8], rays: RayMap, world_from_device: FloatArray) -> None:
        def rays_within(pixel: NDArray[np.intp]) -> tuple[Float32Array, Float32Array]:
            return rays_within_pixels(rays, pixel, self._offsets).world_rays(world_from_device)

        if len(self._offsets) > 1:
            self._renderer.refine(colour, len(self._offsets), rays_within, self._shadows)


def with_inverse_depth(intermediate: GeometryImage, source: Float32Array) -> Float32Array:
    """Extend a pull map (height, width, 2) to (height, width, 3) by the inverse depth found at the source."""
    found = np.isfinite(source[..., 0])
    depth = np.full(source.shape[:2], np.nan, np.float32)
    depth[found] = inverse_depth_at(intermediate.inverse_depth, source[found])
    return np.concatenate([source, depth[..., None]], axis=-1)


def inverse_depth_at(inverse_depth: Float32Array, source: Float32Array) -> Float32Array:
    """Sample an inverse depth image (height, width) at finite positions (n, 2) as the warp does: (n,) in 1/m.

    Bilinear within a surface, the nearest texel at its edges, as `warp.py` states.
    """
    height, width = inverse_depth.shape
    u, v = (np.clip(source[:, axis], 0, size).astype(np.float32) for axis, size in ((0, width), (1, height)))
    texels = np.pad(inverse_depth, 1, mode="edge")
    row, column = (v + np.float32(0.5)).astype(np.intp), (u + np.float32(0.5)).astype(np.intp)
    around = np.stack([texels[row + i, column + j] for i in (0, 1) for j in (0, 1)])
    low, high = around.min(axis=0), around.max(axis=0)
    nearest_row, nearest_column = np.minimum(v, height - 1).astype(np.intp), np.minimum(u, width - 1).astype(np.intp)
    is_edge = high - low > np.float32(SURFACE_STEP) * high
    return np.where(is_edge, inverse_depth[nearest_row, nearest_column], bilinear_at(inverse_depth, u, v))


def position_of_source(view: View, source: Float32Array) -> Float32Array:
    """Return the world points (height, width, 3) that a pull map with inverse depths shows; NaN without a source."""
    inverse = np.where(source[..., 2] > 0, source[..., 2], np.nan).astype(np.float64)
    tangents = view.camera.tangents_of_pixel(source[..., :2].astype(np.float64))
    in_camera = np.concatenate([tangents, -np.ones((*inverse.shape, 1))], axis=-1) / inverse[..., None]
    return transforms.apply(view.world_from_camera, in_camera).astype(np.float32)
