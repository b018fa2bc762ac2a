"""From where an intermediate image was drawn, as a file beside the warp map that leads into it."""

import json
from pathlib import Path

from wlr_render.files import write_text
from wlr_render.rendering.view import View


def write_view(path: str | Path, view: View) -> Path:
    """Write a view as JSON, format `wlr-view` 1: a pinhole's size, focal lengths and centre in pixels, and its pose."""
    camera = view.camera
    record = {
        "format": "wlr-view",
        "version": 1,
        "frame": "openxr",
        "size_px": [camera.width_px, camera.height_px],
        "focal_px": camera.focal_px.tolist(),
        "centre_px": camera.centre_px.tolist(),
        "position_in_device_m": view.viewpoint_in_device.tolist(),
        "world_from_camera": view.world_from_camera.tolist(),
    }
    return write_text(path, json.dumps(record, indent=1) + "\n")
