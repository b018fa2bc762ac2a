"""What an intermediate image cannot show, however fine it is: found with the scene itself, by rays.

The intermediate image is drawn by a camera at one place, the world is seen along bent rays that pass beside it. A point
that a bent ray meets and that something hides from the camera is disoccluded: the warp has nothing right to show. The
paper notes this error; here it is measured.
"""

import numpy as np
from numpy.typing import NDArray

from wlr_render.rendering.ray_intersections import SceneTracer
from wlr_render.rendering.ray_map import RayMap

SAME_POINT = 0.01
"""What lies nearer to a point than this share of its distance does not hide it: it is the surface it belongs to."""


def disoccluded(
    tracer: SceneTracer,
    camera_in_world: NDArray[np.float64],
    field: RayMap,
    world_from_device: NDArray[np.float64],
    position: NDArray[np.floating],
) -> NDArray[np.bool_]:
    """Which pixels' rays meet what the camera cannot see; for rays that meet nothing, whether it sees the same nothing.

    Args:
        tracer: of the scene.
        camera_in_world: (3,) where the intermediate image was drawn from.
        field: world rays of a display's pixels.
        world_from_device: (4, 4) head pose.
        position: (height, width, 3) world points that the rays meet, NaN where nothing.

    Returns:
        (height, width).
    """
    _, direction = field.world_rays(world_from_device)
    return hidden_from(tracer, camera_in_world, direction.reshape(position.shape), position)


def hidden_from(
    tracer: SceneTracer,
    camera_in_world: NDArray[np.float64],
    direction: NDArray[np.floating],
    position: NDArray[np.floating],
) -> NDArray[np.bool_]:
    """As `disoccluded`, of any rays: their world directions (..., 3), and the world points (..., 3) that they meet."""
    met = np.isfinite(position[..., 0])
    towards = np.array(direction)
    towards[met] = position[met] - camera_in_world
    reach = np.where(met, 1.0 - SAME_POINT, np.inf)
    return tracer.occluded(camera_in_world.astype(np.float32), towards, reach)
