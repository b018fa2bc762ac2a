"""The paper's rasterisation (section 4.2), with the warp map from the mesh."""

import functools
from collections.abc import Sequence

import numpy as np

from wlr_render.draw.painters import Frame, TracedPainter, by_colour, channels_of
from wlr_render.draw.ray_tracing import RayRenderer
from wlr_render.draw.sampling import remap
from wlr_render.draw.scene_raster import SceneRaster
from wlr_render.geometry import transforms
from wlr_render.mappings import Eye
from wlr_render.numerics.arrays import Float32Array, FloatArray
from wlr_render.numerics.srgb import decode_srgb, encode_srgb
from wlr_render.warp.raster_camera import EyePlan, RasterPlace
from wlr_render.warp.view import View


class MeshWarpedPainter:
    """Like `WarpedPainter`, but the warp map comes from intersecting each world ray with the mesh.

    This is the paper's map (section 4.2). It is correct everywhere; a point that is hidden in the intermediate image
    gets its occluder's colour. Colours are bilinear in linear light, without the filter of `WarpedPainter`.
    """

    def __init__(
        self,
        mappings: Eye | Sequence[Eye],
        raster: SceneRaster,
        renderer: RayRenderer,
        resolution: float = 1.0,
        raster_camera: RasterPlace = "nearest",
    ) -> None:
        """Prepare like `WarpedPainter`, with a renderer of the same scene."""
        channels = channels_of(mappings)
        panel = channels[0].display.panel
        self._plan = EyePlan.of(channels, (panel.width_px, panel.height_px), resolution, raster_camera)
        self._traced = TracedPainter(mappings, renderer)
        self._raster = raster
        self._background = renderer.scene.background

    def paint(self, viewpoint: FloatArray, world_from_device: FloatArray, with_geometry: bool = False) -> Frame:
        """Draw a frame, see `Painter`."""
        traced = self._traced.paint(viewpoint, world_from_device, with_geometry=True)
        view = self._plan.view(viewpoint, world_from_device)
        image = self._raster.draw(view)
        sources = tuple(source_of_position(view, position) for position in traced.traced)
        light = decode_srgb(image.colour)
        colours = [encode_srgb(remap(light, source[..., :2], self._background)[0]) for source in sources]
        make_colour = functools.partial(by_colour, colours)
        return Frame(
            make_colour, traced.solve_ray_maps, traced=traced.traced, sources=sources, view=view, intermediate=image
        )


def source_of_position(view: View, position: Float32Array) -> Float32Array:
    """Return pixels and inverse depths (height, width, 3) of world points in the view's camera; NaN stays NaN."""
    in_camera = transforms.apply(transforms.inverse(view.world_from_camera), position.astype(np.float64))
    inverse = -1.0 / in_camera[..., 2]
    pixel = view.camera.pixel_of_tangents(in_camera[..., :2] * inverse[..., None])
    return np.concatenate([pixel, inverse[..., None]], axis=-1).astype(np.float32)
