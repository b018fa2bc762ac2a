"""The intermediate image without a GPU: Embree rays through the pixel centres of a pinhole."""

from collections.abc import Collection

import numpy as np

from wlr_render.numerics.arrays import Float32Array
from wlr_render.rendering.ray_render import RayRenderer
from wlr_render.rendering.scene import Scene
from wlr_render.rendering.view import GeometryImage, View


class CpuRaster:
    """Draws one scene from any view, as `raster.GlRaster` does."""

    def __init__(self, scene: Scene) -> None:
        self._renderer = RayRenderer(scene)

    def draw(self, view: View, buffers: Collection[str] = ()) -> GeometryImage:
        """Colour and inverse depth, and of "position", "normal", "ids" those named in `buffers`."""
        height, width = view.camera.height_px, view.camera.width_px
        traced = self._renderer.render_blocks((height, width), lambda rows: _rays(view, rows), buffers)
        # The directions reach one metre along -z, so that the distance along them is the depth.
        inverse_depth = np.reciprocal(traced.distance)
        return GeometryImage(
            traced.colour, inverse_depth, traced.position, traced.normal, traced.instance, traced.triangle
        )


def _rays(view: View, rows: slice) -> tuple[Float32Array, Float32Array]:
    """Rays through some rows' pixel centres: origin (3,), directions (n, 3) with unit depth, world frame."""
    camera = view.camera
    u, v = np.arange(camera.width_px) + 0.5, np.arange(rows.start, rows.stop) + 0.5
    tx = camera.tangents_of_pixel(np.stack([u, np.zeros_like(u)], axis=-1))[:, 0]
    ty = camera.tangents_of_pixel(np.stack([np.zeros_like(v), v], axis=-1))[:, 1]
    rightwards, upwards, backwards = view.world_from_camera[:3, :3].T
    across = tx[:, None] * rightwards - backwards
    direction = across + (ty[:, None] * upwards)[:, None, :]
    return view.viewpoint_in_world.astype(np.float32), direction.reshape(-1, 3).astype(np.float32)
