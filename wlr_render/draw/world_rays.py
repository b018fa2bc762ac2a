"""The world ray of each display pixel, for other renderers."""

from functools import lru_cache

import numpy as np

from wlr_render.mappings import Eye, StatusArray
from wlr_render.numerics.arrays import Float32Array, FloatArray
from wlr_render.warp.ray_map import checked_viewpoint, choose_plan, ray_map

_plan_of = lru_cache(maxsize=8)(choose_plan)  # a search of up to a second, once for each eye


def world_rays(
    eye: Eye, viewpoint: FloatArray | None = None, world_from_device: FloatArray | None = None
) -> tuple[Float32Array, Float32Array, StatusArray]:
    """Return the world ray of every panel pixel, as primary rays for another renderer.

    The pixel must show the colour that the renderer finds along its ray: from the viewpoint, through the optics, the
    pixel then covers the point of the world that the ray meets.

    Args:
        eye: an eye of a headset, from `open_eye` or `calibrate`.
        viewpoint: (3,) centre of the entrance pupil in the device frame, metres; the centre of the eye box by default.
        world_from_device: (4, 4) head pose; the identity by default.

    Returns:
        Origins and unit directions, each (height * width, 3) float32 in the world frame, row by row from the panel's
        top left pixel, metres; NaN where a pixel has no ray. Then `Status` of each pixel, (height, width) uint8. An
        origin lies near the viewpoint, on the straight continuation of the ray behind the optics.

    Raises:
        BadInputError: the viewpoint is not three finite numbers.

    Example:
        >>> import wlr_render as wlr
        >>> eye = wlr.open_eye("northstar", "right")
        >>> origin, direction, status = wlr.world_rays(eye, eye.eye_box.centre + [0.002, -0.001, 0.0])
        >>> direction.shape, status.shape
        ((2304000, 3), (1600, 1440))
    """
    at = checked_viewpoint(eye.eye_box.centre if viewpoint is None else viewpoint)
    rays = ray_map(eye, at, _plan_of(eye))
    origin, direction = rays.world_rays(np.eye(4) if world_from_device is None else world_from_device)
    return origin, direction, rays.status
