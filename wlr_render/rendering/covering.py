"""The camera of the intermediate image: wide enough for all that the warp will ask for."""

from collections.abc import Sequence

import numpy as np

from wlr_render.geometry.pinhole import Pinhole
from wlr_render.mappings import EyeMappings
from wlr_render.numerics.arrays import FloatArray
from wlr_render.rendering.ray_field import asked_tangents


def covering_camera(
    channels: Sequence[EyeMappings],
    device_from_camera: FloatArray,
    resolution: float = 1.0,
    size_px: tuple[int, int] | None = None,
    margin: float = 0.0,
) -> Pinhole:
    """The raster field for all viewpoints in the eye box, found from the mappings at its corners.

    Args:
        channels: one pair, or one per colour channel.
        device_from_camera: (3, 3) axes of the camera.
        resolution: it has `resolution`^2 times as many pixels as the display, square in tangents.
        size_px: (width, height) of the display; the panel's own if None.
        margin: tangents added on every side, for a head that turns between drawing and scan-out. They get pixels of
            their own: the resolution stays.
    """
    box, panel = channels[0].eye_box, channels[0].display.panel
    width, height = (panel.width_px, panel.height_px) if size_px is None else size_px
    corners = [np.array([x, y, z]) for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)]
    tangents = np.concatenate(
        [
            asked_tangents(mappings, device_from_camera, box.at(unit))
            for mappings in channels
            for unit in [np.zeros(3), *corners]
        ]
    )
    low, high = np.nanmin(tangents, axis=0), np.nanmax(tangents, axis=0)
    pixels_per_tangent = resolution * float(np.sqrt(width * height / np.prod(high - low)))
    return Pinhole.covering(np.stack([low - margin, high + margin]), pixels_per_tangent)
