"""Where the virtual and the real dot are seen while the glasses run, on devices whose picture has a closed form."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from present import present

from wlr_render.bench.bench import Bench, Clock, EyeballCamera, EyeTracking, Stage, Target
from wlr_render.bench.simulate_session import simulate
from wlr_render.captures.session import RunTimePlan, SessionPlan
from wlr_render.geometry.directions import dir_of_tangents
from wlr_render.geometry.transforms import rigid, rotations_of_vectors
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.device_file import load_device

ROWS = 40
IMAGE = 0.08
"""Distance of the virtual image of the flat mirror from the middle of its eye box, metres."""


def bench_with(device: str) -> Bench:
    loaded = load_device(device)
    middle = loaded.eyes["right"].eye_box.centre
    camera = EyeballCamera(np.array([1280.0, 1024.0]), np.full(2, 1000.0), np.array([640.0, 512.0]), 0.1)
    return Bench(loaded, "right", camera, Stage(middle), Target(np.zeros((0, 4, 4)), np.zeros(0)))


def plan_for(
    bench: Bench,
    depth_m: float,
    tangents: tuple[float, float] = (-0.15, 0.15),
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0),
    rate: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> RunTimePlan:
    """Dots at a depth before the middle of the eye box; head poses at random, rates given in the device's axes."""
    rng = np.random.default_rng(9)
    middle = bench.stage.origin
    viewpoint = middle + rng.uniform(-3e-3, 3e-3, (ROWS, 3))
    sight = rng.uniform(*tangents, (ROWS, 2))
    in_device = middle + depth_m * np.column_stack([sight, -np.ones(ROWS)])
    head = rigid(rotations_of_vectors(rng.normal(0, 1, (ROWS, 3))), rng.normal(0, 1, (ROWS, 3)))
    dot = np.einsum("nij,nj->ni", head[:, :3, :3], in_device) + head[:, :3, 3]
    return RunTimePlan(
        np.arange(ROWS),
        np.asarray(0.1 * np.arange(ROWS)),
        head,
        head[:, :3, :3] @ velocity,
        head[:, :3, :3] @ rate,
        viewpoint,
        dir_of_tangents(sight),
        dot,
    )


def seen(bench: Bench, plan: RunTimePlan) -> tuple[FloatArray, FloatArray]:
    """Tangents (n, 2) of the virtual and of the real dot."""
    pixel = simulate(bench, SessionPlan(run_time=plan)).run_time_pixel
    return bench.camera.tangents_of_pixel(present(pixel)[:, :2]), bench.camera.tangents_of_pixel(present(pixel)[:, 2:])


@pytest.mark.parametrize("device", ["no_optics", "flat_mirror", "northstar", "birdbath28"])
def test_with_nothing_wrong_the_virtual_dot_covers_the_real_one(device: str) -> None:
    bench = bench_with(device)
    below = -0.3 if device == "northstar" else -0.05
    plan = plan_for(bench, 0.7, (below, below + 0.1), (0.3, 0.2, -0.1), (0.5, -0.4, 0.3))
    virtual, real = seen(bench, plan)
    assert np.isfinite(virtual).all(axis=1).mean() > 0.9
    np.testing.assert_allclose(virtual, real, atol=1e-9)


def test_the_real_dot_is_seen_where_it_is() -> None:
    bench = bench_with("flat_mirror")
    plan = plan_for(bench, 0.7)
    in_device = np.einsum("nji,nj->ni", plan.world_from_device[:, :3, :3], plan.dot - plan.world_from_device[:, :3, 3])
    gap = in_device - plan.viewpoint
    np.testing.assert_allclose(seen(bench, plan)[1], gap[:, :2] / -gap[:, 2:], atol=1e-12)


def test_latency_shifts_a_far_dot_by_angular_rate_times_latency() -> None:
    """The head turns left and up: what stands still in the world has moved right and down before it."""
    bench = bench_with("flat_mirror")
    plan = plan_for(bench, 1e5, (-0.02, 0.02), rate=(0.3, 0.5, 0.0))
    late = replace(bench, clock=Clock(latency_s=0.01))
    virtual, real = seen(late, plan)
    np.testing.assert_allclose(real - virtual, np.tile([0.005, -0.003], (ROWS, 1)), rtol=2e-2)
    np.testing.assert_array_equal(virtual, seen(bench, plan)[0])


def test_latency_shifts_a_near_dot_by_velocity_times_latency_over_depth() -> None:
    bench = replace(bench_with("flat_mirror"), clock=Clock(latency_s=0.01))
    plan = plan_for(bench, 0.5, velocity=(0.2, 0.0, 0.0))
    virtual, real = seen(bench, plan)
    depth = 0.5 + plan.viewpoint[:, 2]
    expected = np.column_stack([-0.2 * 0.01 / depth, np.zeros(ROWS)])
    np.testing.assert_allclose(real - virtual, expected, atol=1e-9)


def test_a_scan_out_delays_each_row_of_the_panel_in_proportion() -> None:
    bench = replace(bench_with("flat_mirror"), clock=Clock(scanout_s=0.016))
    plan = plan_for(bench, 0.5, (-0.05, 0.05), velocity=(0.2, 0.0, 0.0))
    virtual, real = seen(bench, plan)
    image_y = plan.viewpoint[:, 1] + (IMAGE + plan.viewpoint[:, 2]) * virtual[:, 1]
    row = 0.5 - image_y / 0.027  # 0 at the top of the panel, 1 at its bottom
    assert np.ptp(row) > 0.2
    depth = 0.5 + plan.viewpoint[:, 2]
    np.testing.assert_allclose((real - virtual)[:, 0], -0.2 * 0.016 * row / depth, atol=1e-9)


def test_latency_and_scan_out_add() -> None:
    bench = bench_with("flat_mirror")
    plan = plan_for(bench, 0.5, velocity=(0.2, 0.1, 0.0))

    def gap(**clock: Any) -> FloatArray:
        virtual, real = seen(replace(bench, clock=Clock(**clock)), plan)
        return real - virtual

    both = gap(latency_s=0.01, scanout_s=0.016)
    np.testing.assert_allclose(both, gap(latency_s=0.01) + gap(scanout_s=0.016), atol=1e-9)


@pytest.mark.parametrize("depth", [IMAGE, 0.2, 1.0, 1e4])
def test_a_biased_pupil_errs_by_the_dots_distance_from_the_virtual_image(depth: float) -> None:
    """The misalignment b (1 / image - 1 / depth) is the parallax between the two; none for a dot in the image."""
    bench = replace(bench_with("flat_mirror"), eye_tracking=EyeTracking(bias=np.array([1e-3, -5e-4, 0.0])))
    plan = plan_for(bench, depth, (-0.1, 0.1))
    virtual, real = seen(bench, plan)
    usable = np.isfinite(virtual).all(axis=1)
    assert usable.mean() > 0.8
    parallax = 1 / (IMAGE + plan.viewpoint[:, 2]) - 1 / (depth + plan.viewpoint[:, 2])
    expected = -parallax[:, None] * [1e-3, -5e-4]
    np.testing.assert_allclose((virtual - real)[usable], expected[usable], atol=1e-9)


def test_a_pupil_that_moves_with_the_gaze_is_biased_by_the_gaze() -> None:
    bench = bench_with("flat_mirror")
    plan = plan_for(bench, 1.0, (-0.1, 0.1))
    moving = replace(bench, eye_tracking=EyeTracking(gaze_radius=0.0105))
    pupil = plan.viewpoint + 0.0105 * (plan.gaze + [0.0, 0.0, 1.0])
    virtual, real = seen(moving, plan)
    in_device = np.einsum("nji,nj->ni", plan.world_from_device[:, :3, :3], plan.dot - plan.world_from_device[:, :3, 3])
    gap = in_device - pupil
    np.testing.assert_allclose(real, gap[:, :2] / -gap[:, 2:], atol=1e-12)
    ahead = replace(plan, gaze=np.tile([0.0, 0.0, -1.0], (ROWS, 1)))
    np.testing.assert_allclose(*seen(moving, ahead), atol=1e-9)
    assert np.nanmax(np.abs(virtual - real)) > 1e-4


def test_a_dot_beside_the_panel_has_no_readings() -> None:
    """Without a row of the panel there is no time at which it would be seen."""
    bench = bench_with("flat_mirror")
    assert np.isnan(seen(bench, plan_for(bench, 1.0, (0.5, 0.6)))).all()


def test_a_changed_device_is_not_mistaken_for_the_one_before() -> None:
    """The solver keeps what it learnt of a display; another display must not get it."""
    bench = bench_with("northstar")
    plan = plan_for(bench, 0.7, (-0.2, -0.1))
    moved = bench.optics.with_surfaces(
        lambda s: replace(s, device_from_surface=rigid(np.eye(3), np.array([0, 0, 1e-3])) @ s.device_from_surface)
    )
    biased = replace(bench, eye_tracking=EyeTracking(bias=np.array([1e-3, 0.0, 0.0])))
    changed = replace(biased, device=replace(bench.device, eyes={"right": moved}))
    first = np.concatenate(seen(biased, plan))
    second = np.concatenate(seen(changed, plan))
    np.testing.assert_array_equal(np.concatenate(seen(biased, plan)), first)
    assert np.abs(second - first).max() > 1e-6
