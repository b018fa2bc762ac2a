"""Simulated readings: what photographs of the same bench show, with the stated noise; and a camera in the hand."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from present import present
from small_photo_session import CoarseView

from benchmarks.simulated_lab.exact_views import panel_position, pixel_of_point
from benchmarks.simulated_lab.simulate_readings import SimulatedReadings, simulate_readings
from wlr_render.captures.decoded import sample
from wlr_render.captures.photographs import read_each, read_photograph
from wlr_render.geometry import transforms
from wlr_render.numerics.arrays import FloatArray
from wlr_render.simulation.photographs import take_photographs
from wlr_render.simulation.photographs.photo_bench import PhotoBenchOptions
from wlr_render.simulation.photographs.photo_plan import plan_photographs, true_camera_poses
from wlr_render.simulation.photographs.recipe import SimulationRecipe
from wlr_render.simulation.photographs.simulate_photo_session import camera_poses
from wlr_render.simulation.photographs.take_photographs import take

RECIPE = SimulationRecipe("birdbath28", viewpoints=4, bench=PhotoBenchOptions(camera_px=(640, 512)))


@pytest.fixture(scope="module")
def simulated() -> SimulatedReadings:
    return simulate_readings(RECIPE)


def rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def test_readings_scatter_by_their_noise_about_the_true_projections(simulated: SimulatedReadings) -> None:
    truth, session = simulated.truth, simulated.session
    for each, camera, target in zip(session.bare, truth.bare, truth.bare_targets, strict=True):
        seen = simulated.reading.boards[each.path]
        point = transforms.apply(transforms.inverse(camera) @ target, truth.bench.printed.point_of(seen.index))
        off = seen.pixel - truth.eyeball_at_target[each.target_pose].pixel_of_point(point)
        assert rms(off) == pytest.approx(0.02, rel=0.2)
        assert np.all(seen.sigma_px == 0.02)
    for codes, camera in zip(session.display, truth.display, strict=True):
        samples = simulated.reading.panels[codes.folder].samples
        exact = panel_position(truth.bench.optics, truth.bench.eyeball.camera, camera, samples.camera_pixel)
        assert rms(samples.panel_pixel - exact.value) == pytest.approx(0.03, rel=0.1)
        beside = panel_position(
            truth.bench.optics, truth.bench.eyeball.camera, camera, samples.camera_pixel + [1.0, 0.0]
        )
        wide = np.linalg.norm(beside.value - exact.value, axis=-1)
        assert np.nanmedian(samples.scale / wide) == pytest.approx(1.0, abs=0.1)


def photographed(recipe: SimulationRecipe, folder: Path, *names: str) -> SimulatedReadings:
    """Simulate readings, and render the photographs of that session with these names."""
    made = simulate_readings(recipe, folder=folder)
    plan, wanted = plan_photographs(made.truth.bench, recipe.viewpoints), {made.session.folder / name for name in names}
    for pose in camera_poses(made.session, made.truth.bench, plan, true_camera_poses(made.truth.bench, plan)):
        boards = [each for each in pose.boards if each.path in wanted]
        panels = [each for each in pose.panels if each.folder in wanted]
        if boards or panels:
            take(replace(pose, boards=boards, panels=panels))
    return made


@pytest.mark.slow
def test_photographs_of_boards_in_a_workshop_show_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its boards and lenses have more than those of polynomials, of which whole sessions are made."""
    monkeypatch.setattr(take_photographs, "CameraView", CoarseView)
    recipe = replace(RECIPE, bench=replace(RECIPE.bench, family="workshop"))
    names = "see_through/pose1_02.png", "bare/pose0_07.png", "tracking/pose0_after.png", "intrinsics/tracking/04.png"
    made = photographed(recipe, tmp_path, *names)
    for name in names:
        path = made.session.folder / name
        found, said = made.session.board.find(read_photograph(path)), made.reading.boards[path]
        places = {tuple(index): pixel for index, pixel in zip(said.index, said.pixel, strict=True)}
        both = [tuple(index) in places for index in found.index]
        off = found.pixel[both] - [places[tuple(index)] for index in found.index[both]]
        assert len(off) > 0.6 * len(said)
        assert rms(off) < 0.05, path
        assert np.all(np.abs(off.mean(axis=0)) < 0.01), path


@pytest.mark.slow  # renders 46 photographs
def test_photographs_of_the_panel_show_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(take_photographs, "CameraView", CoarseView)
    made = photographed(RECIPE, tmp_path, "display/01")
    truth, session, folder = made.truth, made.session, made.session.display[1].folder
    decoded = sample(session.pattern.decode(read_each(sorted(folder.iterdir())), session.decoding))
    exact = panel_position(truth.bench.optics, truth.bench.eyeball.camera, truth.display[1], decoded.camera_pixel).value
    off = (decoded.panel_pixel - exact)[np.isfinite(exact).all(axis=-1)]
    assert len(off) > 800
    assert np.all(np.abs(np.median(off, axis=0)) < 0.02)
    assert np.median(np.abs(off)) < 0.05


def test_the_session_states_the_readings_and_the_extrinsics_with_their_errors(simulated: SimulatedReadings) -> None:
    session, truth = simulated.session, simulated.truth
    assert session.device_from_tracking is not None
    assert np.array_equal(session.device_from_tracking, truth.bench.stated_device_from_tracking)
    assert not np.allclose(session.device_from_tracking, truth.bench.device_from_tracking, atol=1e-5)
    assert session.tracking_sigma == pytest.approx((np.deg2rad(0.05), 0.3e-3))
    repeated = session.see_through[0], session.see_through[RECIPE.viewpoints]
    assert 0 < np.abs(present(repeated[0].stage) - present(repeated[1].stage)).max() < 5e-6
    assert np.array_equal(present(session.display[0].stage), present(session.see_through[0].stage))


def test_pixels_of_a_workshop_lens_see_the_points_that_they_show() -> None:
    """Its residual distortion and moving pupil: rays of the pixels, by the renderer's lens, meet the points."""
    bench = SimulationRecipe("birdbath28", bench=PhotoBenchOptions(family="workshop")).build()
    point = transforms.apply(
        transforms.inverse(bench.device_from_camera) @ bench.device_from_target[0], bench.printed.points
    )
    pixel = pixel_of_point(bench.eyeball.camera, point, bench.workshop)
    seen = np.all((pixel > 0) & (pixel < bench.eyeball.camera.size_px), axis=1)
    point, pixel = point[seen], pixel[seen]
    ray = bench.eyeball.ray_of_pixel(pixel, np.zeros(2))
    along = np.sum((point - ray[:, :3]) * ray[:, 3:], axis=1)[:, None]
    assert np.max(np.abs(ray[:, :3] + along * ray[:, 3:] - point)) < 1e-7
    assert rms(pixel - pixel_of_point(bench.eyeball.camera, point)) > 0.05
