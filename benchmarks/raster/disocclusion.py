"""Disoccluded pixels of an intermediate image, found by tracing rays in the scene.

The intermediate image is drawn from one position; the eye sees the world along rays that do not pass through that
position. A point that such a ray hits and that is hidden from the camera is disoccluded: the intermediate image has no
data for it. The paper notes this error (section 4.2); here it is measured.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wlr_render.draw.ray_intersections import Intersections, SceneTracer
from wlr_render.numerics.arrays import FloatArray
from wlr_render.scene.scene import world_positions
from wlr_render.warp.ray_map import RayMap

SAME_POINT = 0.01
"""Share of a point's distance within which a surface is the point's own, and does not hide it."""


def disoccluded(
    tracer: SceneTracer,
    camera_in_world: NDArray[np.float64],
    ray_map: RayMap,
    world_from_device: NDArray[np.float64],
    position: NDArray[np.floating],
) -> NDArray[np.bool_]:
    """Return the mask of pixels whose hit points the camera does not see, or that miss where the camera sees an object.

    Args:
        tracer: tracer of the scene.
        camera_in_world: (3,) camera position of the intermediate image.
        ray_map: world rays of a display's pixels.
        world_from_device: (4, 4) head pose.
        position: (height, width, 3) world hit points of the rays, NaN without a hit.

    Returns:
        Mask (height, width).
    """
    _, direction = ray_map.world_rays(world_from_device)
    return hidden_from(tracer, camera_in_world, direction.reshape(position.shape), position)


def hidden_from(
    tracer: SceneTracer,
    camera_in_world: NDArray[np.float64],
    direction: NDArray[np.floating],
    position: NDArray[np.floating],
) -> NDArray[np.bool_]:
    """Return the mask of `disoccluded` for any rays, by their world directions (..., 3) and hit points (..., 3)."""
    met = np.isfinite(position[..., 0])
    towards = np.array(direction)
    towards[met] = position[met] - camera_in_world
    reach = np.where(met, 1.0 - SAME_POINT, np.inf)
    return tracer.occluded(camera_in_world.astype(np.float32), towards, reach)


def hit_positions(tracer: SceneTracer, hits: Intersections, origin: ArrayLike, direction: ArrayLike) -> FloatArray:
    """Return the points at which rays meet the planes of their triangles, in float64; Embree works in float32.

    Args:
        tracer: tracer of the scene.
        hits: hits (...) from `intersect` of these rays.
        origin, direction: (..., 3) rays, in float64 for a float64 result.

    Returns:
        (..., 3) world frame, metres; NaN on a miss.
    """
    shape = (*hits.distance.shape, 3)
    origin = np.broadcast_to(np.asarray(origin, np.float64), shape)
    direction = np.broadcast_to(np.asarray(direction, np.float64), shape)
    position = np.full(shape, np.nan)
    for number, instance in enumerate(tracer.scene.instances):
        chosen = hits.instance == number
        if not chosen.any():
            continue
        mesh = tracer.scene.mesh_of(instance)
        corners = world_positions(mesh, instance)[mesh.triangles[hits.triangle[chosen]]]
        position[chosen] = _meet_planes(corners, origin[chosen], direction[chosen])
    return position


def _meet_planes(corners: FloatArray, origin: FloatArray, direction: FloatArray) -> FloatArray:
    """Return the points at which rays (n, 3) meet the planes of triangles (n, 3 corners, 3)."""
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    along = np.sum((corners[:, 0] - origin) * normal, axis=1) / np.sum(direction * normal, axis=1)
    return np.asarray(origin + along[:, None] * direction)
