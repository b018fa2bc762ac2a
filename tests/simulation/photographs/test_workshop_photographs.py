from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from present import present
from small_photo_session import with_stated_lenses

from benchmarks.simulated_lab.simulate_readings import simulate_readings
from wlr_render.calibration.bench.calibrate_bench import calibrate_bench
from wlr_render.cli import main
from wlr_render.geometry import rays
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.device_file import load_device
from wlr_render.planning.planned_bench import ReadingOptions
from wlr_render.simulation.photographs.board_light import BoardLight
from wlr_render.simulation.photographs.imperfections import BenchImperfections
from wlr_render.simulation.photographs.photo_bench import PhotoBench, PhotoBenchOptions, design_photo_bench
from wlr_render.simulation.photographs.photo_plan import plan_photographs, true_camera_poses
from wlr_render.simulation.photographs.recipe import SimulationRecipe

NONE = BenchImperfections.none()


def bench_of(
    family: Literal["polynomial", "workshop"] = "workshop", seed: int = 1, imperfections: BenchImperfections = NONE
) -> PhotoBench:
    options = PhotoBenchOptions((640, 512), seed=seed, imperfections=imperfections, family=family)
    return design_photo_bench(load_device("plane_plate"), "right", options)


@pytest.fixture(scope="module")
def bench() -> PhotoBench:
    return bench_of()


@pytest.fixture(scope="module")
def perfect() -> PhotoBench:
    return bench_of("polynomial")


def test_stage_board_and_lens_come_from_the_workshop_and_the_rest_stays() -> None:
    usual = BenchImperfections()
    bench, first = bench_of(imperfections=usual), bench_of("polynomial", imperfections=usual)
    kept = bench.options.imperfections
    assert kept == replace(usual.of_photographs)
    assert (kept.turn_urad, kept.bow_mm, kept.dot_error_um, kept.lens) == (0.0, 0.0, 0.0, "brown")
    assert (kept.vibration_px, kept.extrinsics_mm) == (usual.vibration_px, usual.extrinsics_mm)
    np.testing.assert_array_equal(bench.stated_device_from_tracking, first.stated_device_from_tracking)
    assert first.workshop is None
    assert present(bench.workshop).seed != present(bench.tracking.workshop).seed


def test_the_board_has_the_print_and_the_shape_of_the_workshop(bench: PhotoBench) -> None:
    design = bench.board.point_of(bench.board.indices())
    assert bench.workshop is not None
    place = design[:, :2] + bench.workshop.printed_m(design[:, :2])
    np.testing.assert_allclose(bench.printed.points[:, :2], place)
    height = bench.workshop.height_m(place / np.abs(design[:, :2]).max(axis=0))
    above = bench.printed.points[:, 2] - height
    np.testing.assert_allclose(above, above.mean(), atol=1e-5)  # heights are less their mean over the dots


def test_rays_meet_the_bent_board_where_its_dots_are(bench: PhotoBench) -> None:
    light = BoardLight(bench.printed, np.eye(4))
    point = bench.printed.points[[0, 40, -1]].astype(np.float32)
    origin = np.array([0.1, -0.05, -0.8], dtype=np.float32)
    ray = rays.pack(np.broadcast_to(origin, point.shape), np.asarray(point - origin)).astype(np.float32)
    place = light._place(ray[None])[0]
    np.testing.assert_allclose(place, point[:, :2], atol=2e-6)


def test_lens_and_pupil_are_the_workshops(bench: PhotoBench) -> None:
    lens = bench.eyeball
    size, pixel = np.array(lens.camera.size_px), np.array([[30.0, 40.0], [320.0, 256.0], [600.0, 100.0]])
    unit = (pixel - 0.5 * size) / (0.5 * np.linalg.norm(size))
    origin, direction = rays.split(lens.ray_of_pixel(pixel, np.zeros(2)))
    seen = lens.camera.pixel_of_point(direction)
    assert bench.workshop is not None
    np.testing.assert_allclose(seen - pixel, bench.workshop.lens_px(unit), atol=1e-6)
    np.testing.assert_allclose(origin[:, 2], bench.workshop.pupil_m(unit))
    assert not origin[:, :2].any()


def motions(bench: PhotoBench, perfect: PhotoBench, viewpoints: int = 9) -> tuple[FloatArray, FloatArray]:
    plan = plan_photographs(bench, viewpoints)
    true, exact = (true_camera_poses(each, plan).see_through for each in (bench, perfect))
    shift = [
        one.device_from_camera[:3, 3] - other.device_from_camera[:3, 3] for one, other in zip(true, exact, strict=True)
    ]
    turn = [
        one.device_from_camera[:3, :3] @ other.device_from_camera[:3, :3].T
        for one, other in zip(true, exact, strict=True)
    ]
    return np.array(shift), np.array(turn)


def only(bench: PhotoBench, *names: str) -> PhotoBench:
    return replace(bench, workshop=present(bench.workshop).only(*names))


def test_the_stage_errs_and_the_camera_warms_up(bench: PhotoBench, perfect: PhotoBench) -> None:
    shift, _ = motions(only(bench, "hysteresis"), perfect)
    assert set(np.unique(np.round(1e6 * np.abs(shift), 6))) == {2.5}
    assert len(np.unique(np.sign(shift[:, 0]))) == 2  # the stage comes from both sides
    shift, turn = motions(only(bench, "drift"), perfect)
    assert not shift.any()
    between = turn[-1] @ turn[0].T
    angle_px = np.linalg.norm([between[2, 1], between[0, 2], between[1, 0]]) * bench.eyeball.camera.focal_px[0]
    assert 0.1 < angle_px < 0.5
    shift, turn = motions(only(bench), perfect)
    assert np.abs(shift).max() == 0.0
    np.testing.assert_allclose(turn, np.broadcast_to(np.eye(3), turn.shape), atol=1e-15)


def test_sizes_of_polynomials_are_refused_with_a_workshop(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    given = ["simulate", "plane_plate", "--family", "workshop", "--out", str(tmp_path / "out")]
    assert main([*given, "--bow-mm", "0.3"]) == 2
    assert "--bow-mm is used with --family polynomial" in capsys.readouterr().err


@pytest.mark.slow
def test_the_bench_of_a_workshop_is_calibrated() -> None:
    options = PhotoBenchOptions((640, 512), family="workshop")
    recipe = SimulationRecipe("birdbath28", viewpoints=4, bench=options)
    made = simulate_readings(recipe, ReadingOptions(most_dots=60, panel_samples=20))
    found = calibrate_bench(with_stated_lenses(made.session), made.reading)
    assert [check.sentence for check in found.checks if not check.ok] == []
    pairs = zip(made.truth.display, made.session.display, strict=True)
    off = np.array([true[:3, 3] - found.device_from_camera(codes)[:3, 3] for true, codes in pairs])
    # About their mean, which has the error of the stated extrinsics.
    assert (off - off.mean(axis=0)).std() < 30e-6
