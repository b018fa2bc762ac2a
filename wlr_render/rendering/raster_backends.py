"""Backends that draw an intermediate image and warp it, and the choice of one that works.

All backends give the same picture: within 3 codes of 255 in every channel, but for silhouettes, where a pixel's
centre may fall on either side (tests/rendering/test_raster_backends.py holds them to it).
"""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from wlr_render.errors import BadInputError, MissingGlError
from wlr_render.numerics.arrays import Float32Array
from wlr_render.rendering.ray_map import RayMap
from wlr_render.rendering.ray_tracing import RayRenderer
from wlr_render.rendering.scene import Scene
from wlr_render.rendering.srgb import encode_srgb
from wlr_render.rendering.view import GeometryImage, View, image_from_ray_map
from wlr_render.rendering.warp import WarpedImage

BACKENDS = ("auto", "egl", "osmesa", "cpu")
MATERIALS = ("own", "gltf")


@dataclass(frozen=True, eq=False)
class Warped:
    """A warped picture and, when asked for, its geometry.

    Attributes:
        image: the picture.
        sources: the pull map of each ray map, see `WarpedImage.source`; empty if not asked for.
        intermediate: the image that the picture was made of; None if not asked for.
    """

    image: WarpedImage
    sources: tuple[Float32Array, ...] = ()
    intermediate: GeometryImage | None = None


class RasterBackend(Protocol):
    """Draws one scene from any view and warps the picture to display pixels."""

    @property
    def backend(self) -> str:
        """ "egl", "osmesa" or "cpu"."""

    def draw(self, view: View) -> GeometryImage:
        """Draw `view` and fetch colour and inverse depth."""

    def draw_warped(
        self, view: View, ray_maps: Sequence[RayMap], samples_per_axis: int = 1, with_geometry: bool = False
    ) -> Warped:
        """Draw `view` once and warp it along the bent rays of one ray map, or of one each for red, green and blue.

        The ray maps have a viewpoint, which need not be that of the view, and a camera frame in common.
        `samples_per_axis` samples per pixel along each axis, see `raster_camera.samples_for`; `with_geometry` also
        gives the pull maps and the intermediate image.
        """


def open_raster_backend(scene: Scene, backend: str = "auto", materials: str = "own") -> RasterBackend:
    """Open the raster backend for one scene.

    Args:
        scene: what to draw.
        backend: "egl", "osmesa", "cpu", or "auto" for the first that works, in that order.
        materials: "own" for the shading model of docs/conventions.md, "gltf" for pyrender's physically based one,
            which needs OpenGL.

    Raises:
        MissingGlError: OpenGL was asked for by name, or for "gltf" materials, and does not open.
    """
    if backend not in BACKENDS or materials not in MATERIALS:
        raise BadInputError(f"'{backend}' with '{materials}' materials: choose from {BACKENDS} and {MATERIALS}.")
    if backend == "cpu" and materials == "gltf":
        raise BadInputError("glTF materials need OpenGL: choose the backend egl or osmesa, or our own materials.")
    if backend != "cpu":
        try:
            return _GlRasterBackend(scene, backend, materials)
        except MissingGlError:
            if backend != "auto" or materials == "gltf":
                raise
    return EmbreeRaster(scene)


class _GlRasterBackend:
    def __init__(self, scene: Scene, backend: str, materials: str) -> None:
        from wlr_render.rendering.gl import open_context
        from wlr_render.rendering.gl_warp import GlWarp

        self._context = open_context(backend)
        self.backend = self._context.backend
        self._background = _background_code(scene)
        self._warps = {channels: GlWarp(self._context, channels) for channels in (1, 3)}
        if materials == "gltf":
            from wlr_render.rendering.pyrender_drawing import PyrenderView

            self._draw_on_gpu = PyrenderView(self._context, scene).draw_on_gpu
        else:
            from wlr_render.rendering.gl_raster import GlRaster

            self._draw_on_gpu = GlRaster(self._context, scene).draw_on_gpu

    def draw(self, view: View) -> GeometryImage:
        return self._draw_on_gpu(view).read()

    def draw_warped(
        self, view: View, ray_maps: Sequence[RayMap], samples_per_axis: int = 1, with_geometry: bool = False
    ) -> Warped:
        image = self._draw_on_gpu(view)
        moved = _image_from_rays(view, ray_maps[0])

        def warp(slope_offsets: Sequence[Float32Array]) -> WarpedImage:
            return self._warps[len(slope_offsets)].warp(
                image, slope_offsets, moved, self._background, samples_per_axis, with_source=with_geometry
            )

        return _warped(warp, ray_maps, image.read() if with_geometry else None)


def _warped(
    warp: Callable[[Sequence[Float32Array]], WarpedImage],
    ray_maps: Sequence[RayMap],
    intermediate: GeometryImage | None,
) -> Warped:
    """The picture in one warp of all channels; with its geometry, in one warp for each pull map."""
    slope_offsets = [each.slope_offset for each in ray_maps]
    if intermediate is None:
        return Warped(warp(slope_offsets))
    images = [warp([slope_offset]) for slope_offset in slope_offsets]
    sources = tuple(image.source for image in images if image.source is not None)
    return Warped(WarpedImage.of_channels(images), sources, intermediate)


def _image_from_rays(view: View, rays: RayMap) -> NDArray[np.float64]:
    return image_from_ray_map(view, rays.viewpoint_in_device, rays.device_from_camera, view.world_from_device)


def _background_code(scene: Scene) -> tuple[int, int, int]:
    red, green, blue = (int(x) for x in encode_srgb(scene.background))
    return red, green, blue


class EmbreeRaster:
    """`RasterBackend` that draws one scene by ray tracing."""

    backend = "cpu"

    def __init__(self, scene: Scene) -> None:
        self._renderer, self._background = RayRenderer(scene), _background_code(scene)

    def draw(self, view: View, buffers: Collection[str] = ()) -> GeometryImage:
        """Colour and inverse depth, and of "position", "normal", "ids" those named in `buffers`."""
        height, width = view.camera.height_px, view.camera.width_px
        traced = self._renderer.render_blocks((height, width), lambda rows: _rays(view, rows), buffers)
        # The directions reach one metre along -z, so that the distance along them is the depth.
        inverse_depth = np.reciprocal(traced.distance)
        return GeometryImage(
            traced.colour, inverse_depth, traced.position, traced.normal, traced.instance, traced.triangle
        )

    def draw_warped(
        self, view: View, ray_maps: Sequence[RayMap], samples_per_axis: int = 1, with_geometry: bool = False
    ) -> Warped:
        """See `RasterBackend`."""
        from wlr_render.rendering.cpu_warp import warp_on_cpu

        image = self.draw(view)
        moved = _image_from_rays(view, ray_maps[0])

        def warp(slope_offsets: Sequence[Float32Array]) -> WarpedImage:
            return warp_on_cpu(image, view.camera, slope_offsets, moved, self._background, samples_per_axis)

        return _warped(warp, ray_maps, image if with_geometry else None)


def _rays(view: View, rows: slice) -> tuple[Float32Array, Float32Array]:
    """Rays through some rows' pixel centres: origin (3,), directions (n, 3) with unit depth, world frame."""
    camera = view.camera
    u, v = np.arange(camera.width_px) + 0.5, np.arange(rows.start, rows.stop) + 0.5
    tx = camera.tangents_of_pixel(np.stack([u, np.zeros_like(u)], axis=-1))[:, 0]
    ty = camera.tangents_of_pixel(np.stack([np.zeros_like(v), v], axis=-1))[:, 1]
    rightwards, upwards, backwards = view.world_from_camera[:3, :3].T
    across = tx[:, None] * rightwards - backwards
    direction = across + (ty[:, None] * upwards)[:, None, :]
    return view.position_in_world.astype(np.float32), direction.reshape(-1, 3).astype(np.float32)
