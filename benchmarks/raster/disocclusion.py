"""Disoccluded pixels of an intermediate image, found by tracing rays in the scene.

The intermediate image is drawn from one position; the eye sees the world along rays that do not pass through that
position. A point that such a ray hits and that is hidden from the camera is disoccluded: the intermediate image has no
data for it. The paper notes this error (section 4.2); here it is measured.
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
    ray_map: RayMap,
    world_from_device: NDArray[np.float64],
    position: NDArray[np.floating],
) -> NDArray[np.bool_]:
    """Mask of pixels whose hit points are hidden from the camera; without a hit, whether it sees an object there.

    Args:
        tracer: of the scene.
        camera_in_world: (3,) camera position of the intermediate image.
        ray_map: world rays of a display's pixels.
        world_from_device: (4, 4) head pose.
        position: (height, width, 3) world hit points of the rays, NaN without a hit.

    Returns:
        (height, width).
    """
    _, direction = ray_map.world_rays(world_from_device)
    return hidden_from(tracer, camera_in_world, direction.reshape(position.shape), position)


def hidden_from(
    tracer: SceneTracer,
    camera_in_world: NDArray[np.float64],
    direction: NDArray[np.floating],
    position: NDArray[np.floating],
) -> NDArray[np.bool_]:
    """Like `disoccluded`, for any rays: their world directions (..., 3) and hit points (..., 3)."""
    met = np.isfinite(position[..., 0])
    towards = np.array(direction)
    towards[met] = position[met] - camera_in_world
    reach = np.where(met, 1.0 - SAME_POINT, np.inf)
    return tracer.occluded(camera_in_world.astype(np.float32), towards, reach)
