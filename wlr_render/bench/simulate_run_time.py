"""Simulate run-time readings: camera pixels of a real dot and of the virtual dot drawn over it."""

from collections.abc import Mapping, Sequence
from functools import lru_cache

import numpy as np

from wlr_render.bench.bench import Bench
from wlr_render.bench.bench_effects import DOT, LATE, PUPIL, RUN_TIME_KINDS, TURN, displacement
from wlr_render.captures.session import RunTimePlan
from wlr_render.geometry.directions import tangents_of_dir
from wlr_render.geometry.transforms import inverse, rotations_of_vectors
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
    late_s = late_s + _displaced(bench, _by_plan(plan, pixel), _DELAYS)[:, 0]
    tracking = bench.eye_tracking
    pupil = plan.viewpoint + tracking.bias + tracking.gaze_radius * (plan.gaze - _STRAIGHT_AHEAD)
    pupil = pupil + _displaced(bench, _by_plan(plan, pixel), _PUPILS)
    virtual = display.view_dir_of_pixel(pixel, pupil)

    def real_pixel(late_s: FloatArray) -> FloatArray:
        return bench.camera.pixel_of_view_dir(
            see_through.view_dir_of_real_point(_dot_in_device(plan, late_s), pupil).value
        )

    real = real_pixel(late_s)
    if not bench.effects:
        return np.concatenate([bench.camera.pixel_of_view_dir(virtual.value), real], axis=1)
    real = real_pixel(late_s + _displaced(bench, {("camera", "delay"): real}, _DELAYS)[:, 0])
    places = _by_plan(plan, pixel) | {("camera", "picture"): real}
    turned = rotations_of_vectors(_displaced(bench, places, _TURNS))
    shown = bench.camera.pixel_of_view_dir(np.einsum("nij,nj->ni", turned, virtual.value))
    return np.concatenate([shown + _displaced(bench, places, _SHIFTS), real], axis=1)


_DELAYS, _SHIFTS, _TURNS, _PUPILS = (
    [kind for kind, each in RUN_TIME_KINDS.items() if each.displacement == displaced]
    for displaced in (LATE, DOT, TURN, PUPIL)
)


def _by_plan(plan: RunTimePlan, pixel: FloatArray) -> dict[tuple[str, str], FloatArray]:
    """Return the coordinates of each kind of effect except the camera's, (n, v), for dots drawn at pixels (n, 2)."""
    gravity, rate = gravity_and_rate(plan)
    return {
        ("panel", "picture"): pixel,
        ("panel", "delay"): pixel,
        ("head motion", "picture by gravity"): gravity,
        ("head motion", "picture by rate"): rate,
        ("head motion", "delay by rate"): rate,
        ("eye tracking", "picture by pupil"): plan.viewpoint,
        ("eye tracking", "pupil by pupil"): plan.viewpoint,
        ("eye tracking", "pupil by gaze"): tangents_of_dir(plan.gaze),
        ("time", "picture"): plan.time_s[:, None],
    }


def gravity_and_rate(plan: RunTimePlan) -> tuple[FloatArray, FloatArray]:
    """Return the direction of gravity and the rate of the head in each row, (n, 3), device axes."""
    device_from_world = inverse(plan.world_from_device)[:, :3, :3]
    return -device_from_world[:, :, 1], np.asarray(np.einsum("nij,nj->ni", device_from_world, plan.head_rate))


def _displaced(
    bench: Bench, places: Mapping[tuple[str, str], FloatArray], kinds: Sequence[tuple[str, str]]
) -> FloatArray:
    """Return the sum of the effects of some kinds at their places, (n, components) seconds, pixels or radians."""
    rows, components = len(next(iter(places.values()))), len(RUN_TIME_KINDS[kinds[0]].per_displacement)
    total = np.zeros((rows, components))
    for kind in kinds:
        moved = displacement(bench.effects, *kind, places[kind]) if kind in places else None
        total = total if moved is None else total + moved
    return total


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
