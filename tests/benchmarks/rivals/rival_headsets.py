"""Captures of headsets in closed form, for published methods."""

from collections.abc import Callable
from typing import Any

import numpy as np

from wlr_render.captures.correspondences import DisplayCaptures, SeeThroughCaptures
from wlr_render.geometry.directions import dir_of_tangents
from wlr_render.mappings import EyeBox, Panel
from wlr_render.numerics.arrays import FloatArray

EYE_BOX = EyeBox(np.array([0.03, 0.0, 0.02]), np.array([0.010, 0.008, 0.006]))
PANEL = Panel(1000, 800)
PIXELS = PANEL.grid(13, 11).reshape(-1, 2)
EYE: dict[str, Any] = {"device": "toy", "eye": "right", "eye_box": EYE_BOX}
IN_VOLUME = EYE_BOX.at(np.random.default_rng(1).uniform(-1.0, 1.0, (30, 3)))
IN_PLANE = EYE_BOX.at(np.random.default_rng(1).uniform(-1.0, 1.0, (30, 3)) * [1.0, 1.0, 0.0])


def display_captures(
    positions: FloatArray, direction_of: Callable[..., Any], pixels: FloatArray = PIXELS
) -> DisplayCaptures:
    """Pixels seen from positions (k, 3), in the directions (n, 3) that `direction_of` gives (pixel, viewpoint)."""
    capture = np.repeat(np.arange(len(positions)), len(pixels))
    pixel, viewpoint = np.tile(pixels, (len(positions), 1)), positions[capture]
    direction = direction_of(pixel, viewpoint)
    direction = direction / np.linalg.norm(direction, axis=1, keepdims=True)
    return DisplayCaptures(
        **EYE,
        panel=PANEL,
        viewpoint=viewpoint,
        view_dir=direction,
        pixel=pixel,
        capture=capture,
        sigma_arcmin=np.array(0.0),
    )


def see_through_captures(
    positions: FloatArray, tangents_of: Callable[..., Any], depths: tuple[float, float] = (0.4, 3.0)
) -> SeeThroughCaptures:
    """Dots of flat targets seen from positions (k, 3), under the tangents of `tangents_of` (point, viewpoint)."""
    grid = np.stack(np.meshgrid(np.linspace(-0.6, 0.6, 13), np.linspace(-0.5, 0.5, 11)), axis=-1).reshape(-1, 2)
    targets = [np.column_stack([grid * depth, np.full(len(grid), -depth)]) for depth in depths]
    point = np.tile(np.concatenate(targets) + EYE_BOX.centre, (len(positions), 1))
    capture = np.repeat(np.arange(len(positions)), len(depths) * len(grid))
    pose = np.tile(np.repeat(np.arange(len(depths)), len(grid)), len(positions))
    direction = dir_of_tangents(tangents_of(point, positions[capture]))
    rows: dict[str, Any] = {
        "viewpoint": positions[capture],
        "view_dir": direction,
        "capture": capture,
        "target_pose": pose,
    }
    return SeeThroughCaptures(**EYE, **rows, point=point, sigma_arcmin=np.array(0.0))
