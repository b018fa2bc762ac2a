"""Each imperfection of an ordinary bench is measured back from the tables."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray

from oracle.captures import CAMERA_CENTRE_PX, CAMERA_FOCAL_PX, TARGET_DISTANCES_MM, Plan
from oracle.effects import Effect, draw_effect
from oracle.nature import PERFECT, BenchNature, smooth_field
from oracle.run_time import RunTimePlan, observe_run_time
from oracle.session import Session, observe

PLAN = Plan(grid=(12, 9), dots=(9, 6), sigma_px=0.1)
QUIET = replace(PLAN, sigma_px=0.0)


@cache
def ideal_tables(plan: Plan, seed: int) -> Session:
    """Of a perfect bench without noise."""
    return observe(replace(plan, sigma_px=0.0), [], np.random.default_rng(seed), PERFECT)


def dots(nature: BenchNature, plan: Plan = QUIET, seed: int = 1) -> tuple[NDArray[Any], Any]:
    """Dot noise and motion, camera pixels: (captures, dots, 2), and the table of a perfect bench in that shape."""
    plan = replace(plan, grid=(2, 2), off_plane=0)  # what the display shows is not looked at
    seen = observe(plan, [], np.random.default_rng(seed), nature).seethrough
    ideal = ideal_tables(QUIET, 1).seethrough  # without noise nothing random is in it
    shape = (-1, plan.dots[0] * plan.dots[1])
    gap = np.stack([seen[c] - ideal[c] for c in ("camera_u", "camera_v")], axis=-1)
    return gap.reshape(*shape, 2), ideal.reshape(shape)


def display(nature: BenchNature, plan: Plan = PLAN, seed: int = 1) -> NDArray[Any]:
    """Change of the decoded pixels by a nature, (captures, points, 2) panel pixels."""
    seen, ideal = observe(plan, [], np.random.default_rng(seed), nature).display, ideal_tables(QUIET, seed).display
    gap = np.stack([seen[c] - ideal[c] for c in ("pixel_u", "pixel_v")], axis=-1)
    return gap.reshape(-1, plan.grid[0] * plan.grid[1], 2)


def sigma(values: ArrayLike) -> float:
    """Root mean square; NaN where a point was not seen."""
    return float(np.sqrt(np.nanmean(np.square(values))))


def moved_by(effect: Effect) -> float:
    """By how many panel pixels an effect moves what the display table has, on average along u."""
    hidden, plain = (observe(QUIET, e, np.random.default_rng(1)).display["pixel_u"] for e in ([effect], []))
    return float(abs(np.nanmean(hidden - plain)))


def test_a_perfect_nature_changes_nothing_and_no_nature_changes_the_positions() -> None:
    perfect, plain, real = (
        observe(PLAN, [], np.random.default_rng(4), *nature)
        for nature in ((BenchNature(),), (), (BenchNature(0.01, 1e-5, noise_factor=2.0, shared=0.5),))
    )
    for name in ("display", "seethrough"):
        for column in getattr(plain, name).dtype.names:
            np.testing.assert_array_equal(getattr(perfect, name)[column], getattr(plain, name)[column])
        for column in ("stage_x_mm", "stage_y_mm", "time_s"):
            np.testing.assert_array_equal(getattr(real, name)[column], getattr(plain, name)[column])


def test_effects_leave_the_nature_as_it_is() -> None:
    nature = BenchNature(0.02, 2e-5, noisy_share=0.3, noisy_factor=3.0)
    scaled = draw_effect("panel_scale", np.random.default_rng(1))
    clean, hidden = (observe(PLAN, e, np.random.default_rng(4), nature) for e in ([], [scaled]))
    np.testing.assert_array_equal(clean.seethrough["camera_u"], hidden.seethrough["camera_u"])


def test_positions_repeat_to_the_stated_sigma_in_both_parts() -> None:
    gap, ideal = dots(BenchNature(repeatability_mm=0.05))
    # A camera that moves sideways by s sees a dot at distance d shifted by -f s / d.
    for pose, distance in enumerate(TARGET_DISTANCES_MM):
        mean = np.nanmean(gap[ideal["target_pose"][:, 0] == pose], axis=1)
        assert sigma(mean) * distance / CAMERA_FOCAL_PX == pytest.approx(0.05, rel=0.45)
    mean = np.nanmean(gap, axis=1) * (np.array(TARGET_DISTANCES_MM)[ideal["target_pose"][:, 0]])[:, None]
    assert sigma(mean) / CAMERA_FOCAL_PX == pytest.approx(0.05, rel=0.2)
    by_capture = np.nanmean(display(BenchNature(repeatability_mm=0.05), QUIET), axis=1)
    known = moved_by(Effect("camera_pupil_offset", {"x_mm": 0.05, "y_mm": 0.0, "z_mm": 0.0}))
    assert sigma(by_capture[:, 0]) == pytest.approx(known, rel=0.35)
    assert abs(np.corrcoef(by_capture[:-1, 0], by_capture[1:, 0])[0, 1]) < 0.4


def test_the_camera_is_turned_anew_in_each_capture() -> None:
    gap, ideal = dots(BenchNature(turns_rad=1e-3))
    uv = np.stack([ideal["camera_u"], ideal["camera_v"]], axis=-1) - CAMERA_CENTRE_PX
    rolls, yaws = [], []
    for moved, place in zip(gap, uv, strict=True):
        seen = np.isfinite(moved).all(axis=1)
        columns = np.stack([np.ones(seen.sum()), -place[seen, 1] / CAMERA_FOCAL_PX], axis=-1)
        fitted = np.linalg.lstsq(columns, moved[seen, 0], rcond=None)[0]
        yaws.append(fitted[0] / CAMERA_FOCAL_PX)
        rolls.append(np.polyfit(place[seen, 0], moved[seen, 1], 1)[0])
    assert sigma(yaws) == pytest.approx(1e-3, rel=0.3)
    assert sigma(rolls) == pytest.approx(1e-3, rel=0.5)
    turned = np.nanmean(display(BenchNature(turns_rad=1e-3), QUIET), axis=1)
    known = moved_by(Effect("camera_rotation", {"x_deg": 0.0, "y_deg": np.degrees(1e-3), "z_deg": 0.0}))
    assert sigma(turned[:, 0]) == pytest.approx(known, rel=0.35)


def test_a_target_stands_as_wrong_in_all_its_captures() -> None:
    shift = [dots(BenchNature(target_mm=0.5), seed=seed) for seed in range(20)]
    size = []
    for gap, ideal in shift:
        mean = np.nanmean(gap, axis=1) * np.array(TARGET_DISTANCES_MM)[ideal["target_pose"][:, 0]][:, None]
        for pose in range(3):
            own = mean[ideal["target_pose"][:, 0] == pose] / CAMERA_FOCAL_PX
            assert np.ptp(own, axis=0).max() < 0.05
            size.append(own.mean(axis=0))
    assert sigma(size) == pytest.approx(0.5, rel=0.2)
    gap, _ = dots(BenchNature(target_rad=5e-3))
    middle, edge = (sigma(gap.reshape(len(gap), 6, 9, 2)[:, rows][:, :, columns]) for rows, columns in
                    (([2, 3], [4]), ([0, 5], [0, 8])))  # fmt: skip
    assert edge > 3.0 * middle


def test_noise_is_larger_by_its_factor() -> None:
    assert sigma(dots(BenchNature(noise_factor=1.1), PLAN)[0]) == pytest.approx(0.11, rel=0.02)
    ratio = sigma(display(BenchNature(noise_factor=1.1))) / sigma(display(PERFECT))
    assert ratio == pytest.approx(1.1, rel=0.01)


def test_a_share_of_the_captures_is_noisier() -> None:
    for gap in (dots(BenchNature(noisy_share=1 / 3, noisy_factor=2.5), PLAN)[0],
                dots(BenchNature(noisy_share=1 / 3, noisy_factor=2.5), PLAN, 2)[0]):  # fmt: skip
        by_capture = np.sqrt(np.nanmean(gap**2, axis=(1, 2)))
        noisy = by_capture > 0.16
        assert noisy.sum() == 16
        assert by_capture[noisy].mean() == pytest.approx(0.25, rel=0.05)
        assert by_capture[~noisy].mean() == pytest.approx(0.1, rel=0.05)
    ratio = display(BenchNature(noisy_share=1 / 3, noisy_factor=2.5)) / display(PERFECT)
    by_capture = np.nanmedian(ratio, axis=(1, 2))
    assert np.sum(by_capture > 1.5) == 16
    np.testing.assert_allclose(np.sort(by_capture), [1.0] * 32 + [2.5] * 16, rtol=0.02)


def test_each_colour_is_a_photograph_with_a_field_of_its_own() -> None:
    plan = replace(PLAN, channels=(0, 1))
    nature = BenchNature(shared=1.0)
    noise = observe(plan, [], np.random.default_rng(1), nature).display["pixel_u"]
    noise = (noise - observe(replace(plan, sigma_px=0.0), [], np.random.default_rng(1)).display["pixel_u"]).reshape(
        -1, 2
    )
    seen = np.isfinite(noise).all(axis=1)
    assert abs(np.corrcoef(noise[seen].T)[0, 1]) < 0.2


def test_a_smooth_field_is_normal() -> None:
    place = np.random.default_rng(0).uniform(0.0, 1000.0, (40, 2))
    values = smooth_field(np.tile(place, (500, 1)), np.repeat(np.arange(500), 40), 100.0, np.random.default_rng(1))
    assert np.mean(values**2) == pytest.approx(1.0, rel=0.03)
    assert np.mean(values**4) == pytest.approx(3.0, rel=0.08)


def test_students_t_has_the_same_sigma_and_heavier_tails() -> None:
    nature = BenchNature(t_dof=5.0)
    gap = np.concatenate([dots(nature, PLAN, seed)[0].ravel() for seed in range(3)])
    gap = gap[np.isfinite(gap)]
    assert np.std(gap) == pytest.approx(0.1, rel=0.04)
    assert np.mean(np.abs(gap) > 0.4) > 10 * 6.3e-5
    assert np.quantile(np.abs(gap), 0.6827) < 0.093


def test_run_time_noise_has_its_size_and_its_noisy_recordings() -> None:
    plan = RunTimePlan(recordings=12, moments=60, sigma_px=0.3)
    nature = BenchNature(0.05, 1e-3, noise_factor=1.1, noisy_share=0.25, noisy_factor=3.0, shared=0.5)
    quiet = observe_run_time(replace(plan, sigma_px=0.0), [], np.random.default_rng(2))
    noisy = observe_run_time(plan, [], np.random.default_rng(2), nature)
    gap = np.concatenate([noisy.real - quiet.real, noisy.virtual - quiet.virtual], axis=1).reshape(12, -1)
    by_recording = np.sqrt(np.nanmean(gap**2, axis=1))
    assert np.sum(by_recording > 0.6) == 3
    assert np.median(by_recording) == pytest.approx(0.33, rel=0.05)
