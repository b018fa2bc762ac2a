"""Simulate run-time readings: camera pixels of a real dot and of the virtual dot drawn over it."""

from functools import lru_cache

import numpy as np

from wlr_render.bench.bench import Bench
from wlr_render.captures.session import RunTimePlan
from wlr_render.geometry.transforms import rotations_of_vectors
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.device import EyeOptics
from wlr_render.optics.traced_mappings import TracedDisplay, TracedSeeThrough

_STRAIGHT_AHEAD = np.array([0.0, 0.0, -1.0])


def run_time_readings(bench: Bench, plan: RunTimePlan) -> FloatArray:
    """Return the camera pixels (n, 4) of the virtual dot (2) and the real dot (2), seen from the true pupil.

    The frame is drawn for the head pose and the tracked viewpoint of its row's time, with exact models of the headset.
    It appears later, by the clock's latency and the scan-out of its panel row, when the head has moved on, and is seen
    from the true pupil. NaN where a dot cannot be seen or drawn.
    """
    display = _display(bench.optics, bench.target_wavelength_um)
    see_through = TracedSeeThrough(bench.optics, bench.target_wavelength_um)
    pixel = drawn_pixels(bench, plan)
    height = bench.optics.panel.pixels.size_px[1]
    late_s = bench.clock.latency_s + bench.clock.scanout_s * pixel[:, 1] / height
    tracking = bench.eye_tracking
    pupil = plan.viewpoint + tracking.bias + tracking.gaze_radius * (plan.gaze - _STRAIGHT_AHEAD)
    virtual = display.view_dir_of_pixel(pixel, pupil)
    real = see_through.view_dir_of_real_point(_dot_in_device(plan, late_s), pupil)
    return np.concatenate([bench.camera.pixel_of_view_dir(dot.value) for dot in (virtual, real)], axis=1)


def drawn_pixels(bench: Bench, plan: RunTimePlan) -> FloatArray:
    """Return the panel pixels (n, 2) of the virtual dots, drawn for the tracked viewpoint and head pose."""
    see_through = TracedSeeThrough(bench.optics, bench.target_wavelength_um)
    drawn_for = _dot_in_device(plan, np.zeros(len(plan)))
    wanted = see_through.view_dir_of_real_point(drawn_for, plan.viewpoint)
    display = _display(bench.optics, bench.target_wavelength_um)
    return display.pixel_of_view_dir(wanted.value, plan.viewpoint).value


@lru_cache(maxsize=4)
def _display(optics: EyeOptics, wavelength_um: float) -> TracedDisplay:
    """Return the display's mapping, cached: its fitted first guess is reused while only tracking and clock change."""
    return TracedDisplay(optics, wavelength_um)


def _dot_in_device(plan: RunTimePlan, later_s: FloatArray) -> FloatArray:
    """Return dots (n, 3) in the device frame, each `later_s` (n,) after its row's time, at constant head velocity."""
    turn = rotations_of_vectors(plan.head_rate * later_s[:, None])
    world_from_device = turn @ plan.world_from_device[:, :3, :3]
    position = plan.world_from_device[:, :3, 3] + plan.head_velocity * later_s[:, None]
    return np.asarray(np.einsum("nji,nj->ni", world_from_device, plan.dot - position))
