"""Simulate run-time readings: camera pixels of a real dot and of the virtual dot drawn over the real one."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from wlr_render.bench.bench import Bench
from wlr_render.bench.bench_effects import DOT, LATE, PUPIL, RUN_TIME_KINDS, TURN, displacement
from wlr_render.captures.session import RunTimePlan
from wlr_render.geometry.directions import tangents_of_dir
from wlr_render.geometry.transforms import inverse, rotations_of_vectors
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.traced_mappings import TracedDisplay, TracedSeeThrough

_STRAIGHT_AHEAD = np.array([0.0, 0.0, -1.0])


@dataclass(frozen=True, eq=False)
class _Seen:
    """Dots of a recording as drawn and as seen, with one row for each row of the plan.

    Attributes:
        pixel: (n, 4) camera pixels of the virtual and the real dot.
        drawn_at: (n, 2) panel pixels of the virtual dots.
        starts: solutions for the directions of the dot as drawn, of the virtual dot and of the real dot; see
            `mappings.QueryResult.warm_start`.
    """

    pixel: FloatArray
    drawn_at: FloatArray
    starts: tuple[FloatArray | None, ...]


@dataclass(frozen=True, eq=False)
class RunTimeViews:
    """Dots of a recording as drawn and as seen on a bench, with the warm start for neighbouring benches.

    The frame is drawn for the head pose and the tracked viewpoint of its row's time, with exact models of the headset.
    It appears later, by the clock's latency and the scan-out of the panel row, when the head has moved on, and is seen
    from the true pupil.

    Attributes:
        bench: the bench.
        plan: setup of the run-time readings.
        near: views on a neighbouring bench with the same plan, from which the solve starts.
    """

    bench: Bench
    plan: RunTimePlan
    near: "RunTimeViews | None" = None

    @property
    def pixel(self) -> FloatArray:
        """Camera pixels (n, 4) of the virtual dot (2) and the real dot (2); NaN where one cannot be seen or drawn."""
        return self._seen.pixel

    @property
    def drawn_at(self) -> FloatArray:
        """Panel pixels (n, 2) of the virtual dots, drawn for the tracked viewpoint and head pose."""
        return self._seen.drawn_at

    @cached_property
    def _seen(self) -> _Seen:
        bench, plan = self.bench, self.plan
        starts = (None, None, None) if self.near is None else self.near._seen.starts
        # Release the neighbour; otherwise a chain of neighbours would stay in memory.
        object.__setattr__(self, "near", None)
        display = TracedDisplay(bench.optics, bench.target_wavelength_um)
        see_through = TracedSeeThrough(bench.optics, bench.target_wavelength_um)
        wanted = _dot_in_device(plan, np.zeros(len(plan)))
        drawn = see_through.view_dir_of_real_point(wanted, plan.viewpoint, starts[0])
        drawn_at = display.pixel_of_view_dir(drawn.value, plan.viewpoint).value
        places = places_by_plan(plan, drawn_at)
        tracking = bench.eye_tracking
        pupil = plan.viewpoint + tracking.bias + tracking.gaze_radius * (plan.gaze - _STRAIGHT_AHEAD)
        pupil = pupil + _displaced(bench, places, _PUPILS)
        virtual = display.view_dir_of_pixel(drawn_at, pupil, starts[1])
        late_s = bench.clock.latency_s + bench.clock.scanout_s * drawn_at[:, 1] / bench.optics.panel.pixels.size_px[1]
        late_s = late_s + _displaced(bench, places, _DELAYS)[:, 0]
        real = see_through.view_dir_of_real_point(_dot_in_device(plan, late_s), pupil, starts[2])
        shown, imaged = virtual.value, bench.camera.pixel_of_view_dir(real.value)
        if bench.effects:
            late_s = late_s + _displaced(bench, {("camera", "delay"): imaged}, _DELAYS)[:, 0]
            real = see_through.view_dir_of_real_point(_dot_in_device(plan, late_s), pupil, real.warm_start)
            imaged = bench.camera.pixel_of_view_dir(real.value)
            places |= {("camera", "picture"): imaged}
            turned = rotations_of_vectors(_displaced(bench, places, _TURNS))
            shown = np.einsum("nij,nj->ni", turned, shown)
        pixel = bench.camera.pixel_of_view_dir(shown) + _displaced(bench, places, _SHIFTS)
        starts = (drawn.warm_start, virtual.warm_start, real.warm_start)
        return _Seen(np.concatenate([pixel, imaged], axis=1), drawn_at, starts)


_DELAYS, _SHIFTS, _TURNS, _PUPILS = (
    [kind for kind, each in RUN_TIME_KINDS.items() if each.displacement == displaced]
    for displaced in (LATE, DOT, TURN, PUPIL)
)


def places_by_plan(plan: RunTimePlan, pixel: FloatArray) -> dict[tuple[str, str], FloatArray]:
    """Return the coordinates (n, v) of each kind of effect, except the camera's, for dots drawn at pixels (n, 2).

    Gravity and the angular rate of the head are in device axes.
    """
    device_from_world = inverse(plan.world_from_device)[:, :3, :3]
    gravity = -device_from_world[:, :, 1]
    rate = np.asarray(np.einsum("nij,nj->ni", device_from_world, plan.head_rate))
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
        ("time", "delay"): plan.time_s[:, None],
    }


def _displaced(
    bench: Bench, places: Mapping[tuple[str, str], FloatArray], kinds: Sequence[tuple[str, str]]
) -> FloatArray:
    """Return the sum (n, components) of the effects of some kinds at their coordinates, in s, px, m or rad."""
    rows, components = len(next(iter(places.values()))), len(RUN_TIME_KINDS[kinds[0]].per_displacement)
    total = np.zeros((rows, components))
    for kind in kinds:
        moved = displacement(bench.effects, *kind, places[kind]) if kind in places else None
        total = total if moved is None else total + moved
    return total


def _dot_in_device(plan: RunTimePlan, later_s: FloatArray) -> FloatArray:
    """Return the dots (n, 3) in the device frame `later_s` (n,) after their rows' times, at constant head velocity."""
    turn = rotations_of_vectors(plan.head_rate * later_s[:, None])
    world_from_device = turn @ plan.world_from_device[:, :3, :3]
    position = plan.world_from_device[:, :3, 3] + plan.head_velocity * later_s[:, None]
    return np.asarray(np.einsum("nji,nj->ni", world_from_device, plan.dot - position))
