"""Whole frames by ray tracing, and an eyeball camera's picture through the optics."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from wlr_render.draw.ray_intersections import Intersections, SceneTracer
from wlr_render.draw.sampling import remap
from wlr_render.draw.shading import Shaded, Surfaces, shade
from wlr_render.draw.thread_pool import for_blocks
from wlr_render.geometry import directions, rays
from wlr_render.geometry.pinhole import Pinhole
from wlr_render.mappings import Eye
from wlr_render.numerics.arrays import Float32Array, FloatArray
from wlr_render.numerics.srgb import decode_srgb, encode_srgb
from wlr_render.scene.scene import Scene

_Value = TypeVar("_Value", bound=np.generic)

RaysOfRows = Callable[[slice], tuple[Float32Array, Float32Array]]
"""Function of some rows of a picture to the origins and directions of their rays, world frame; the direction (n, 3)
float32 with n = rows * width, row by row, and the origin (n, 3) or (3,). Rays with a NaN see the background. Called
from several threads at once."""

RaysWithinPixels = Callable[[NDArray[np.intp]], tuple[Float32Array, Float32Array]]
"""Function of pixels (n,), numbered row by row, to origins and directions of some rays within each, both
(n * count, 3) float32 pixel by pixel; otherwise like `RaysOfRows`."""

_RAYS_PER_BLOCK = 1 << 16
_DIFFERENCE = 8
"""Difference to a neighbour in some colour, in codes, above which a pixel is drawn with several rays."""


@dataclass(frozen=True, eq=False)
class TracedImage:
    """A picture of any rays and, per pixel, the point that its ray meets. Rows run down, like the caller's rays.

    Attributes:
        colour: (height, width, 3) uint8 sRGB.
        distance: (height, width) float32 along the ray, in lengths of its direction; inf for a miss.
        position: (height, width, 3) float32 world frame, NaN for a miss; None if not requested.
    """

    colour: NDArray[np.uint8]
    distance: Float32Array
    position: Float32Array | None = None

    @classmethod
    def empty(cls, shape: tuple[int, int], with_position: bool) -> "TracedImage":
        """Return images to be filled in."""
        position = np.full((*shape, 3), np.nan, np.float32) if with_position else None
        return cls(np.empty((*shape, 3), np.uint8), np.empty(shape, np.float32), position)


class RayRenderer:
    """Renders a scene by ray tracing; it keeps the acceleration structure and the shading tables."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.tracer = SceneTracer(scene)
        self.surfaces = Surfaces.of(scene)

    def render_blocks(
        self, shape: tuple[int, int], rays_of_rows: RaysOfRows, with_position: bool = False, shadows: bool = False
    ) -> TracedImage:
        """Return a frame of rays that are made when they are needed, in the thread that traces them.

        Args:
            shape: (height, width).
            rays_of_rows: see `RaysOfRows`.
            with_position: True to return the points that the rays meet as well.
            shadows: whether surfaces cast shadows.
        """
        image = TracedImage.empty(shape, with_position)
        background = encode_srgb(self.scene.background)

        def render(rows: slice) -> None:
            hits, shaded = self._trace(rays_of_rows(rows), shadows)
            code = encode_srgb(shaded.colour)
            _flat_rows(image.colour, rows)[:] = _scattered(code, shaded.index, len(hits.distance), background)
            _flat_rows(image.distance, rows)[:] = hits.distance
            if image.position is not None:
                _flat_rows(image.position, rows)[shaded.index] = shaded.position.T

        for_blocks(render, shape[0], _rows_per_block(shape))
        return image

    def render_rays(
        self, origin: ArrayLike, direction: ArrayLike, with_position: bool = False, shadows: bool = False
    ) -> TracedImage:
        """Render a frame of given rays: (height, width, 3) world frame, origin possibly (3,); NaN for no ray."""
        origin, direction = np.broadcast_arrays(np.asarray(origin, np.float32), np.asarray(direction, np.float32))

        def rays_of_rows(rows: slice) -> tuple[Float32Array, Float32Array]:
            return origin[rows].reshape(-1, 3), direction[rows].reshape(-1, 3)

        height, width = direction.shape[:2]
        return self.render_blocks((height, width), rays_of_rows, with_position, shadows)

    def refine(
        self, colour: NDArray[np.uint8], count: int, rays_within: RaysWithinPixels, shadows: bool = False
    ) -> None:
        """Replace the pixels of a frame that differ from a neighbour by means in linear light, in place.

        The neighbours of replaced pixels are compared again, so that a thin line is followed where single rays miss it.

        Args:
            colour: (height, width, 3) uint8 sRGB, one ray per pixel.
            count: rays per pixel in place of one.
            rays_within: see `RaysWithinPixels`.
            shadows: whether surfaces cast shadows.
        """
        flat, is_mean = colour.reshape(-1, 3), np.zeros(colour.shape[0] * colour.shape[1], np.bool_)
        chosen = np.flatnonzero(_differs_from_neighbour(colour))
        while chosen.size:
            means = np.empty((chosen.size, 3), np.uint8)

            def render(part: slice, chosen: NDArray[np.intp] = chosen, means: NDArray[np.uint8] = means) -> None:
                hits, shaded = self._trace(rays_within(chosen[part]), shadows)
                # Clip before the mean: the display clips the light of each ray.
                light = np.clip(shaded.colour, np.float32(0), np.float32(1))
                light = _scattered(light, shaded.index, len(hits.distance), self.scene.background)
                means[part] = encode_srgb(np.einsum("nkc->nc", light.reshape(-1, count, 3)) / np.float32(count))

            for_blocks(render, chosen.size, max(1, _RAYS_PER_BLOCK // count))
            flat[chosen] = means
            is_mean[chosen] = True
            # The neighbours of other pixels have not changed.
            beside = _neighbours_that_differ(colour, chosen)
            chosen = beside[~is_mean[beside]]

    def _trace(self, rays: tuple[Float32Array, Float32Array], shadows: bool) -> tuple[Intersections, Shaded]:
        origin, direction = rays
        origin = np.broadcast_to(origin, direction.shape)
        hits = self.tracer.intersect(origin, direction)
        shadow_tracer = self.tracer if shadows else None
        return hits, shade(self.scene, self.surfaces, hits, origin, direction, shadow_tracer)


def _differs_from_neighbour(colour: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Return which pixels differ from one of their four neighbours by more than `_DIFFERENCE`: (height, width)."""
    cross = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
    difference = np.maximum(cv2.dilate(colour, cross) - colour, colour - cv2.erode(colour, cross))
    red, green, blue = np.moveaxis(difference, -1, 0)
    return np.asarray(np.maximum(np.maximum(red, green), blue) > _DIFFERENCE)


def _neighbours_that_differ(colour: NDArray[np.uint8], pixel: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return the pixels that differ by more from a neighbour in `pixel` (n,), each once; numbered row by row."""
    (height, width), flat = colour.shape[:2], colour.reshape(-1, 3)
    row, column = np.divmod(pixel, width)
    found = []
    for is_inside, step in ((column > 0, -1), (column < width - 1, 1), (row > 0, -width), (row < height - 1, width)):
        own = pixel[is_inside]
        difference = np.abs(flat[own].astype(np.int16) - flat[own + step])
        found.append(own[(difference > _DIFFERENCE).any(axis=1)] + step)
    return np.unique(np.concatenate(found))


def _rows_per_block(shape: tuple[int, ...]) -> int:
    return max(1, _RAYS_PER_BLOCK // max(1, shape[1]))


def _flat_rows(image: NDArray[_Value], rows: slice) -> NDArray[_Value]:
    """Return some rows of (height, width, ...) as (rows * width, ...), a view."""
    block = image[rows]
    return block.reshape(-1, *block.shape[2:])


def _scattered(
    components: NDArray[_Value], index: NDArray[np.intp], count: int, background: NDArray[_Value]
) -> NDArray[_Value]:
    """Return components (3, m) of chosen rays as (count, 3), with the background elsewhere."""
    if len(index) == count:
        return components.T
    result = np.empty((count, 3), components.dtype)
    for column, component, value in zip(result.T, components, background, strict=True):
        column[:] = value
        column[index] = component  # takes a fifth of the time of assigning rows
    return result


@dataclass(frozen=True, eq=False)
class EyeView:
    """An eyeball camera's picture with the display off, and the panel pixels that it sees.

    Attributes:
        real: (height, width, 3) uint8 sRGB, the real scene as seen through the combiner.
        panel_pixel: (height, width, 2) pixel of the panel that is reflected there, NaN where there is none.
    """

    real: NDArray[np.uint8]
    panel_pixel: FloatArray

    def with_display(self, shown: NDArray[np.uint8], gain: float = 1.0, see_through: float = 1.0) -> NDArray[np.uint8]:
        """Add the display's light to the picture.

        Args:
            shown: (panel height, panel width, 3) uint8 sRGB, the panel's picture.
            gain: share of the panel's light that reaches the eye.
            see_through: share of the world's light that reaches the eye.

        Returns:
            (height, width, 3) uint8 sRGB.
        """
        reflected, _ = remap(decode_srgb(shown), self.panel_pixel)
        light = see_through * decode_srgb(self.real) + gain * reflected
        return encode_srgb(light.astype(np.float32))


def eye_view(
    truth: Eye, renderer: RayRenderer, viewpoint: FloatArray, world_from_device: FloatArray, camera: Pinhole
) -> EyeView:
    """Render the eyeball camera's view through the optics.

    Args:
        truth: mappings of the true optics, which the eye looks through.
        renderer: renderer of the real scene.
        viewpoint: (3,) entrance pupil, device frame.
        world_from_device: (4, 4) head pose.
        camera: the eyeball camera; axes of the device frame.
    """
    view_dir = directions.dir_of_tangents(camera.pixel_centre_tangents())
    real_ray = rays.transformed(world_from_device, truth.see_through.real_ray_of_view_dir(view_dir, viewpoint).value)
    origin, direction = rays.split(real_ray)
    real = renderer.render_rays(origin, direction, shadows=True)
    return EyeView(real.colour, truth.display.pixel_of_view_dir(view_dir, viewpoint).value)
