"""Geometry layers of a frame, per panel pixel: depth, position, normal, instance and albedo.

The world ray of each pixel's centre meets the scene itself, whichever method draws the frame: the layers show the exact
geometry, and no value is a mean over neighbouring surfaces, even with supersampling.
"""

from collections.abc import Collection
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from wlr_render.draw.ray_tracing import RayRenderer
from wlr_render.draw.shading import meet_surfaces
from wlr_render.draw.thread_pool import for_blocks
from wlr_render.geometry import transforms
from wlr_render.numerics.arrays import FloatArray
from wlr_render.warp.ray_map import RayMap

Layer = Literal["depth", "position", "normal", "instance", "albedo"]
LAYERS: tuple[Layer, ...] = get_args(Layer)
INSTANCE = "instance.id"
"""Channel of the instances: 1 + index into `Scene.instances`."""
_CHANNELS: dict[Layer, tuple[str, ...]] = {
    "depth": ("depth.Z", "depth.distance"),
    "position": ("position.X", "position.Y", "position.Z"),
    "normal": ("normal.X", "normal.Y", "normal.Z"),
    "instance": (INSTANCE,),
    "albedo": ("albedo.R", "albedo.G", "albedo.B"),
}
MEANINGS: dict[Layer, str] = {
    "depth": "Z: metres from the viewpoint along -z of the device frame; distance: metres from the viewpoint",
    "position": "point in the world frame, metres",
    "normal": "unit normal in the world frame, interpolated between the vertices, towards the eye",
    "instance": "id: number of the instance, from 1",
    "albedo": "linear RGB of the surface, without light",
}
"""Content of each layer, in words; 0 in every channel of a pixel that shows nothing."""
_ROWS_PER_BLOCK = 32


def frame_layers(
    renderer: RayRenderer, rays: RayMap, world_from_device: FloatArray, layers: Collection[Layer] = LAYERS
) -> dict[str, NDArray[Any]]:
    """Return the channels of the layers by name, (height, width) each.

    Args:
        renderer: renderer of the scene.
        rays: rays of all pixels at the frame's viewpoint.
        world_from_device: (4, 4) head pose of the frame.
        layers: layers to return.

    Returns:
        float32, and uint32 for `INSTANCE`; `MEANINGS` has units and frames. 0 where a ray meets nothing or there is no
        ray.
    """
    height, width = rays.shape
    names = [name for layer in LAYERS if layer in layers for name in _CHANNELS[layer]]
    flat: dict[str, NDArray[Any]] = {
        name: np.zeros(height * width, np.uint32 if name == INSTANCE else np.float32) for name in names
    }
    eye = transforms.apply(world_from_device, rays.viewpoint_in_device)
    ahead = -world_from_device[:3, 2]

    def fill(rows: slice) -> None:
        origin, direction = rays.world_rays(world_from_device, rows)
        met = meet_surfaces(renderer.surfaces, renderer.tracer.intersect(origin, direction), origin, direction)
        pixel = met.index + rows.start * width
        values: dict[Layer, Any] = {"position": met.position, "normal": met.normal}
        if "depth" in layers:
            from_eye = met.position - eye[:, None]
            values["depth"] = ahead @ from_eye, np.linalg.norm(from_eye, axis=0)
        if "instance" in layers:
            values["instance"] = (met.on_surface.instance + 1,)
        if "albedo" in layers:
            values["albedo"] = renderer.surfaces.albedo(met.on_surface)
        for layer in layers:
            for name, each in zip(_CHANNELS[layer], values[layer], strict=True):
                flat[name][pixel] = each

    for_blocks(fill, height, _ROWS_PER_BLOCK)
    return {name: values.reshape(height, width) for name, values in flat.items()}
