"""Captures of headsets whose prescription is known."""

import numpy as np

from wlr_render.captures.correspondences import Captures
from wlr_render.mappings import Eye
from wlr_render.optics.device import EyeOptics
from wlr_render.optics.device_file import load_device
from wlr_render.optics.traced_mappings import TracedDisplay, TracedSeeThrough
from wlr_render.simulation.capture_setup import CaptureSetup
from wlr_render.simulation.simulate_captures import simulate_display, simulate_see_through


def prescription(name: str) -> EyeOptics:
    return load_device(name).eyes["right"]


def captured(
    optics: EyeOptics,
    count: int = 9,
    noise: float = 0.0,
    stage_error_m: float = 0.0,
    seed: int = 1,
    grid: tuple[int, int] = (15, 13),
    stage_turn_rad: float = 0.0,
) -> Captures:
    truth = Eye(
        "test", "right", TracedDisplay(optics, 0.55), TracedSeeThrough(optics, 0.55), optics.eye_box, optics.field
    )
    setup = CaptureSetup(truth, noise, stage_error_m, optics.field, grid, stage_turn_rad=stage_turn_rad)
    rng, positions = np.random.default_rng(seed), setup.camera_positions("planar", count)
    return Captures(simulate_display(setup, positions, rng), simulate_see_through(setup, positions, rng))
