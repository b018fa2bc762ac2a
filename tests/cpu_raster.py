"""The intermediate image by ray tracing: the oracle of `GlRaster`."""

import numpy as np

from wlr_render.draw.ray_tracing import RayRenderer
from wlr_render.numerics.arrays import Float32Array
from wlr_render.scene.scene import Scene
from wlr_render.warp.stored_picture import NEAREST_M
from wlr_render.warp.view import GeometryImage, View


def raster_on_cpu(scene: Scene, view: View) -> GeometryImage:
    """Colour and inverse depth."""
    height, width = view.camera.height_px, view.camera.width_px
    traced = RayRenderer(scene).render_blocks((height, width), lambda rows: _rays(view, rows))
    # The directions reach one metre along -z, so that the distance along them is the depth. A camera that stands on
    # a surface would have an infinite one.
    inverse_depth = np.reciprocal(np.maximum(traced.distance, np.float32(NEAREST_M)))
    return GeometryImage(traced.colour, inverse_depth)


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
