"""Imperfections of the simulated bench: each has the size that is stated, and none of them is nothing."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np
import pytest
from present import present
from scipy.optimize import least_squares

from wlr_render.errors import BadInputError
from wlr_render.geometry import transforms
from wlr_render.lenses.lens_camera import LensCamera
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.device_file import load_device
from wlr_render.simulation.photographs.imperfections import BenchImperfections
from wlr_render.simulation.photographs.photo_bench import PhotoBench, PhotoBenchOptions, design_photo_bench
from wlr_render.simulation.photographs.photo_plan import plan_photographs, true_camera_poses
from wlr_render.simulation.photographs.take_photographs import blurred, veiling_glare

NONE = BenchImperfections.none()


def bench_with(seed: int = 1, **sizes: Any) -> PhotoBench:
    options = PhotoBenchOptions(camera_px=(640, 512), seed=seed, imperfections=replace(NONE, **sizes))
    return design_photo_bench(load_device("plane_plate"), "right", options)


def rms(values: FloatArray | Sequence[Any], axis: int | None = None) -> Any:
    return np.sqrt(np.mean(np.square(values), axis=axis))


def test_none_is_all_sizes_zero_and_a_brown_lens() -> None:
    assert set(asdict(NONE).values()) == {0.0, "brown"}
    usual = BenchImperfections()
    assert all(value for value in asdict(usual).values())
    assert usual.scaled(1.0) == usual
    twice = usual.scaled(2.0)
    assert twice.lens == usual.lens
    assert twice.bow_mm == 2 * usual.bow_mm


@pytest.mark.parametrize("wrong", [{"bow_mm": -0.1}, {"turn_urad": float("nan")}, {"gamma_error": 1.5}])
def test_imperfections_that_cannot_be_are_refused(wrong: Mapping[str, Any]) -> None:
    with pytest.raises(BadInputError, match=r"give a finite size of 0 or more|is impossible"):
        BenchImperfections(**wrong)


def test_a_perfect_bench_has_the_poses_and_the_board_that_are_stated() -> None:
    bench = bench_with()
    position = np.array([0.003, -0.002, 0.001])
    pose = bench.camera_at(position)
    assert np.array_equal(pose[:3, :3], bench.device_from_camera[:3, :3])
    assert np.array_equal(pose[:3, 3], bench.device_from_camera[:3, 3] + bench.stage_axes @ position)
    assert np.array_equal(bench.stated_device_from_tracking, bench.device_from_tracking)
    assert np.array_equal(bench.printed.points, bench.board.point_of(bench.board.indices()))
    assert bench.eyeball_focused(0) is bench.eyeball
    plan = plan_photographs(bench, 4)
    visits = true_camera_poses(bench, plan)
    for visit, commanded in zip(visits.display, plan.sweep, strict=True):
        assert np.array_equal(present(visit.reading), commanded)
        assert np.array_equal(visit.device_from_camera, bench.camera_at(commanded))


def test_a_perfect_print_is_drawn_as_its_design_bit_for_bit() -> None:
    bench = bench_with()
    place = np.random.default_rng(2).uniform(-0.3, 0.3, (50, 60, 2)).astype(np.float32)
    place[3, 4] = np.nan
    softness = np.full((50, 60), 1e-3, dtype=np.float32)
    drawn, designed = (board.reflectance(place, softness) for board in (bench.printed, bench.board))
    assert drawn.dtype == designed.dtype
    np.testing.assert_array_equal(drawn, designed)


def test_the_stage_turns_and_bends_by_its_size_along_each_axis() -> None:
    errors = bench_with(turn_urad=100.0, straightness_um=2.0).stage_errors
    for axis in range(3):
        position = np.zeros((400, 3))
        position[:, axis] = (np.arange(400) / 199.5 - 1.0) * errors.half_travel_m[axis]
        motion = np.stack([errors.motion(each) for each in position])
        np.testing.assert_allclose(motion.std(axis=0)[:3], 100e-6, rtol=0.01)
        np.testing.assert_allclose(motion.std(axis=0)[3:], 2e-6, rtol=0.01)


def test_turns_of_the_carriage_carry_the_pupil_by_its_arm() -> None:
    errors = bench_with(turn_urad=100.0, arm_mm=50.0).stage_errors
    motion = errors.motion(0.7 * errors.half_travel_m)
    np.testing.assert_allclose(motion[3:], np.cross(motion[:3], errors.arm_m), atol=1e-12)
    assert np.linalg.norm(errors.arm_m) == pytest.approx(0.05)


def test_visits_scatter_by_repeatability_jitter_and_readback() -> None:
    bench = bench_with(repeatability_um=5.0, turn_jitter_urad=10.0, readback_um=0.5)
    plan = plan_photographs(bench, 250)
    visits = true_camera_poses(bench, plan)
    commanded = np.concatenate([plan.sweep, plan.sweep[:1]] * 2)
    reading = np.stack([present(visit.reading) for visit in visits.see_through])
    assert rms(reading - commanded) == pytest.approx(0.5e-6, rel=0.1)
    true = np.stack([bench.camera_at(each) for each in commanded])
    pose = np.stack([visit.device_from_camera for visit in visits.see_through])
    assert rms(pose[:, :3, 3] - true[:, :3, 3]) == pytest.approx(5e-6, rel=0.1)
    turned = np.swapaxes(true[:, :3, :3], 1, 2) @ pose[:, :3, :3]
    turn = np.stack([turned[:, 2, 1], turned[:, 0, 2], turned[:, 1, 0]])
    np.testing.assert_allclose(rms(turn, axis=1), 10e-6, rtol=0.15)
    assert len({tuple(each) for each in reading}) == len(reading)  # each visit has its own


def test_the_panel_is_photographed_in_the_visits_of_the_first_target_pose() -> None:
    bench = bench_with(repeatability_um=5.0, readback_um=0.5)
    visits = true_camera_poses(bench, plan_photographs(bench, 5))
    assert visits.display == visits.see_through[:5]


def test_the_camera_creeps_by_its_size_over_the_session_in_one_direction() -> None:
    bench = bench_with(creep_um=3.0)
    plan = plan_photographs(bench, 6)
    visits = true_camera_poses(bench, plan)
    # Bare photographs of the first pose come first, those of the last pose last.
    commanded = np.concatenate([plan.bare, np.concatenate([plan.sweep, plan.sweep[:1]] * 2), plan.bare])
    count = len(plan.bare)
    order = [*visits.bare[:count], *visits.see_through, *visits.bare[count:]]
    pose = zip(order, commanded, strict=True)
    shift = np.stack([visit.device_from_camera[:3, 3] - bench.camera_at(each)[:3, 3] for visit, each in pose])
    along = shift @ shift[-1] / np.linalg.norm(shift[-1])
    assert along[-1] - along[0] == pytest.approx(3e-6)
    assert np.all(np.diff(along) > 0)
    np.testing.assert_allclose(np.linalg.norm(shift, axis=1), along, atol=1e-15)


def test_stage_axes_are_off_their_right_angles_by_the_skew() -> None:
    square, skew = bench_with().stage_axes, bench_with(axes_skew_mrad=1.0).stage_axes
    unit = np.linalg.solve(square, skew)
    unit /= np.linalg.norm(unit, axis=0)
    cosines = (unit.T @ unit)[[0, 0, 1], [1, 2, 2]]
    np.testing.assert_allclose(np.abs(cosines), 1e-3, rtol=0.01)


def test_the_print_is_bowed_twisted_scaled_and_scattered_by_its_sizes() -> None:
    flat, bowed = bench_with(), bench_with(bow_mm=0.2)
    points = bowed.printed.points
    grid = points[:, 2].reshape(bowed.board.rows, bowed.board.columns)
    middle = bowed.printed.height(np.zeros(2))
    assert abs(grid[0, 0] - middle) == pytest.approx(0.2e-3)
    assert np.ptp([grid[0, 0], grid[0, -1], grid[-1, 0], grid[-1, -1]]) < 1e-12
    assert points[:, 2].mean() == pytest.approx(0.0, abs=1e-12)
    twisted = bench_with(twist_mm=0.05).printed.points[:, 2].reshape(grid.shape)
    corners = np.array([twisted[0, 0], -twisted[0, -1], -twisted[-1, 0], twisted[-1, -1]])
    np.testing.assert_allclose(np.abs(corners), 0.05e-3, rtol=1e-6)
    assert np.ptp(corners) < 1e-12
    place = flat.printed.points[:, :2]
    larger = bench_with(scale_error=2e-4, anisotropy=5e-4).printed.points[:, :2]
    x, y = ((larger[:, axis] @ place[:, axis]) / (place[:, axis] @ place[:, axis]) for axis in (0, 1))
    assert abs(x - 1) == pytest.approx(2e-4, rel=1e-6)
    assert abs(y / x - 1) == pytest.approx(5e-4, rel=1e-6)
    scattered = bench_with(dot_error_um=10.0).printed.points[:, :2] - place
    np.testing.assert_allclose(rms(scattered, axis=0), 10e-6, rtol=0.15)


def test_both_signs_of_the_bow_come_by_seed() -> None:
    assert {np.sign(bench_with(seed, bow_mm=0.2).printed.bow_m) for seed in range(1, 9)} == {-1.0, 1.0}


@pytest.mark.slow
def test_stated_extrinsics_are_off_by_their_sigmas() -> None:
    shift, turn = [], []
    for seed in range(1, 16):
        bench = bench_with(seed, extrinsics_mm=0.3, extrinsics_deg=0.05)
        shift.append(bench.stated_device_from_tracking[:3, 3] - bench.device_from_tracking[:3, 3])
        off = bench.stated_device_from_tracking[:3, :3] @ bench.device_from_tracking[:3, :3].T
        turn.append([off[2, 1], off[0, 2], off[1, 0]])
    assert rms(shift) == pytest.approx(0.3e-3, rel=0.3)
    assert np.rad2deg(rms(turn)) == pytest.approx(0.05, rel=0.3)


@pytest.mark.parametrize("kind", ["rational", "thin-prism"])
def test_a_fit_of_five_terms_leaves_the_stated_pixels_of_the_lens(kind: str) -> None:
    camera = bench_with(lens=kind, lens_px=0.08, decentring=3e-4).eyeball.camera
    assert camera.kind == kind
    ends = (np.linspace(1, length - 1, 31) for length in camera.size_px)
    pixel = np.stack(np.meshgrid(*ends), axis=-1).reshape(-1, 2)
    tangents = camera.tangents_of_pixel(pixel)
    start = LensCamera(camera.size_px, camera.focal_px, camera.centre_px)
    fit = least_squares(
        lambda values: (start.with_values(values).pixel_of_tangents(tangents) - pixel).ravel(), start.values
    )
    assert rms(fit.fun) == pytest.approx(0.08, rel=0.1)


def test_a_fisheye_lens_sees_the_field_of_the_brown_one() -> None:
    fisheye, brown = (bench_with(lens=kind).eyeball.camera for kind in ("fisheye", "brown"))
    edge = np.array([[0.0, 256.0], [640.0, 256.0]])
    seen, wanted = (np.abs(camera.tangents_of_pixel(edge)[:, 0]) for camera in (fisheye, brown))
    np.testing.assert_allclose(seen, wanted, rtol=0.1)


def test_the_lens_breathes_between_the_nearest_and_the_farthest_target() -> None:
    bench = bench_with(focus_breathing=2e-4)
    near, far = (bench.eyeball_focused(pose).camera.focal_px for pose in (0, 1))
    np.testing.assert_allclose(near / far - 1.0, 2e-4, rtol=1e-3)
    np.testing.assert_allclose(0.5 * (near + far), bench.eyeball.camera.focal_px)


def test_sensors_clip_black_and_are_not_quite_linear() -> None:
    bench = bench_with(black_clip=0.02, gamma_error=0.02)
    sensor = replace(bench.eyeball_sensor, full_well_e=1e12, vignetting=0.0, exposure=1.0, bits=16)
    assert abs(sensor.gamma - 1.0) == pytest.approx(0.02)
    light = np.tile(np.array([0.0, 0.015, 0.5], dtype=np.float32), (4, 1))
    grey = sensor.expose(light, np.random.default_rng(1)) / 65535
    assert np.all(grey[:, :2] == 0.0)
    np.testing.assert_allclose(grey[:, 2], 0.48 ** (1.0 / sensor.gamma), atol=1e-4)


@pytest.mark.parametrize("deviation", [(0.15, 0.0), (0.1, -0.11), (0.6, 0.7)])
def test_vibration_blurs_along_its_direction_by_its_size(deviation: tuple[float, float]) -> None:
    light = np.zeros((31, 31), dtype=np.float32)
    light[15, 15] = 1.0
    # Ringing of the small kernel is cut off at zero light, so that only bright surroundings keep the moments.
    seen = blurred(light + 1.0, np.array(deviation)) - 1.0
    v, u = np.indices(light.shape) - 15.0
    assert seen.sum() == pytest.approx(1.0, abs=1e-4)
    moments = np.array([[np.sum(seen * a * b) for a in (u, v)] for b in (u, v)])
    np.testing.assert_allclose(moments, np.outer(deviation, deviation), atol=2e-3)


def test_stray_light_is_as_much_as_the_light_and_smooth() -> None:
    light = np.zeros((120, 160), dtype=np.float32)
    light[50:70, 70:90] = 1.0
    glare = veiling_glare(light)
    assert glare.shape == light.shape
    assert glare.sum() == pytest.approx(light.sum(), rel=0.02)
    assert glare.max() < 0.3


def test_the_stage_errors_vanish_at_reading_zero() -> None:
    bench = bench_with(turn_urad=100.0, straightness_um=2.0, arm_mm=50.0)
    assert np.array_equal(bench.camera_at(np.zeros(3)), bench.device_from_camera)
    assert transforms.is_rotation(bench.camera_at(bench.stage_errors.half_travel_m)[:3, :3])
