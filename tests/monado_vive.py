"""Directions of pixels by Monado's formula for SteamVR's JSON file (`vive_config.c`, `u_distortion_mesh.c`)."""

from typing import Any

import numpy as np

from wlr_render.geometry.directions import dir_of_tangents
from wlr_render.numerics.arrays import FloatArray

COLOURS = ("distortion_red", "distortion", "distortion_blue")


def monados_directions(content: dict[str, Any], eye: int, colour: int, pixel: FloatArray) -> FloatArray:
    """`u_compute_distortion_vive` and `_calculate_fov` of Monado, then the turn of the eye."""
    transform, device = content["tracking_to_eye_transform"][eye], content["device"]
    width, height = (device[f"eye_target_{side}_in_pixels"] for side in ("width", "height"))
    aspect, scale = device["physical_aspect_x_over_y"], 1 + transform["grow_for_undistort"]
    radial = transform[COLOURS[colour]]
    x = 2 * pixel[:, 0] / width - 1 - radial["center_x"]
    y = (2 * pixel[:, 1] / height - 1) / aspect - radial["center_y"]
    r2 = x * x + y * y
    k1, k2, k3 = radial["coeffs"][:3]
    d = 1 / (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) + radial["coeffs"][3]
    u = 0.5 + (x * d + radial["center_x"]) * 0.5 / scale
    v = 0.5 + (y * d + radial["center_y"]) * 0.5 / scale * aspect
    (fx, _, cx), (_, fy, cy), _ = np.array(transform["intrinsics"]) / scale
    left, right, up, down = -(1 - cx) / fx, (1 + cx) / fx, (1 + cy) / fy, -(1 - cy) / fy
    tangents = np.stack([left + u * (right - left), up + v * (down - up)], axis=-1)
    return np.asarray(dir_of_tangents(tangents) @ np.array(transform["eye_to_head"]).T)
