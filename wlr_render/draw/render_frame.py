"""One frame of a scene for one eye, ray traced or rasterised."""

from functools import lru_cache
from typing import Literal, get_args

import numpy as np

from wlr_render.draw.painters import RESOLUTION, SUPERSAMPLE, Frame, TracedPainter
from wlr_render.draw.raster_painter import WarpedPainter
from wlr_render.draw.ray_tracing import RayRenderer
from wlr_render.draw.scene_raster import open_scene_raster
from wlr_render.errors import BadInputError
from wlr_render.mappings import Eye
from wlr_render.numerics.arrays import FloatArray
from wlr_render.scene.scene import Scene
from wlr_render.warp.raster_camera import intermediate_camera
from wlr_render.warp.ray_map import checked_viewpoint, middle_axes

FrameMethod = Literal["raytrace", "raster"]

_LARGEST_SIDE_PX = 8192  # longest side of the intermediate image: 0.8 GB of colours and depths

_renderer_of = lru_cache(maxsize=2)(RayRenderer)  # keeps the acceleration structure of the scene


@lru_cache(maxsize=4)
def _traced_painter(eye: Eye, scene: Scene, shadows: bool, supersample: int) -> TracedPainter:
    """Return the painter of an eye's ray-traced frames; cached for the next frames."""
    return TracedPainter(eye, _renderer_of(scene), supersample, shadows)


def _resolution(eye: Eye, largest_px: int) -> float:
    """Return the largest resolution up to `RESOLUTION` at which no side exceeds `largest_px` and 8192 pixels."""
    panel = eye.display.panel
    camera = intermediate_camera((eye,), middle_axes(eye), RESOLUTION, (panel.width_px, panel.height_px), 0.0)
    without_margin = min(largest_px, _LARGEST_SIDE_PX) - 4  # the camera's margin is two pixels at any resolution
    return RESOLUTION * min(1.0, without_margin / max(camera.size_px))


def render(
    eye: Eye,
    scene: Scene,
    viewpoint: FloatArray | None = None,
    world_from_device: FloatArray | None = None,
    *,
    method: FrameMethod = "raytrace",
    shadows: bool = True,
    supersample: int = SUPERSAMPLE,
    with_geometry: bool = False,
) -> Frame:
    """Draw the image that an eye's panel must show so that a scene appears fixed in the world.

    Offline and one frame at a time; `Compositor` draws in real time.

    Args:
        eye: an eye of a headset, from `open_eye` or `calibrate`.
        scene: from `load_scene`.
        viewpoint: (3,) centre of the entrance pupil in the device frame, metres; the centre of the eye box by default.
        world_from_device: (4, 4) head pose; the identity by default.
        method: "raytrace" follows the world ray of every panel pixel. "raster" draws an intermediate image with OpenGL,
            of at most 8192 pixels along each axis, and warps it; without OpenGL the frame is ray traced.
        shadows: whether to draw shadows (ray-traced frames only).
        supersample: rays per pixel along each axis where a pixel differs from its neighbours by more than 8 codes;
            elsewhere one (ray-traced frames only).
        with_geometry: True to add the world point of each pixel, `Frame.position`, and the warp map of raster frames.

    Returns:
        A frame: `colour` (height, width, 3) uint8 sRGB, the scene's background where a pixel has no ray.

    Raises:
        BadInputError: the viewpoint is not three finite numbers, or an unknown method.

    Example:
        >>> import wlr_render as wlr
        >>> wlr.render(wlr.open_eye("northstar"), wlr.load_scene("desk")).save("panel.png")
    """
    at = checked_viewpoint(eye.eye_box.centre if viewpoint is None else viewpoint)
    pose = np.eye(4) if world_from_device is None else world_from_device
    if method not in get_args(FrameMethod):
        raise BadInputError(f"method is '{method}'; choose from {', '.join(get_args(FrameMethod))}.")
    raster = open_scene_raster(scene) if method == "raster" else None
    if raster is None:
        return _traced_painter(eye, scene, shadows, supersample).paint(at, pose, with_geometry)
    try:
        resolution = _resolution(eye, raster.context.largest_side_px)
        frame = WarpedPainter(eye, raster, resolution).paint(at, pose, with_geometry)
        _ = frame.colour  # must be read while the context exists
        return frame
    finally:
        raster.context.release()
