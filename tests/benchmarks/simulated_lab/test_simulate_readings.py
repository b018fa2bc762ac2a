"""Simulated readings: what photographs of the same bench show, with the stated noise, and the faults asked for."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.simulated_lab.exact_views import panel_position, pixel_of_real_point
from benchmarks.simulated_lab.faults import BoardMove, Exchange, Faults, HeadsetSlip, Shift
from benchmarks.simulated_lab.simulate_readings import simulate_readings
from wlr_render.captures.decoded import sample
from wlr_render.captures.photo_session_checks import check_session
from wlr_render.captures.photographs import read_each, read_photograph
from wlr_render.errors import BadInputError
from wlr_render.geometry import transforms
from wlr_render.jobs.plan.planned_bench import ReadingOptions
from wlr_render.simulation.photographs.imperfections import BenchImperfections
from wlr_render.simulation.photographs.photo_bench import PhotoBenchOptions
from wlr_render.simulation.photographs.photo_plan import plan_photographs, true_camera_poses
from wlr_render.simulation.photographs.recipe import SimulationRecipe
from wlr_render.simulation.photographs.simulate_photo_session import camera_poses
from wlr_render.simulation.photographs.take_photographs import take
from wlr_render.toml_files import Table

RECIPE = SimulationRecipe("birdbath28", viewpoints=4, bench=PhotoBenchOptions(camera_px=(640, 512)))
SHIFT = Shift((0.2, -0.1, 0.3), (0.0, 0.05, 0.0))


@pytest.fixture(scope="module")
def simulated():
    return simulate_readings(RECIPE)


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def seen_at(simulated, name):
    """A photograph's observation by its name."""
    return simulated.reading.boards[simulated.session.folder / name]


def moved_px(simulated, faulty, name):
    """By how much the dots of a photograph are elsewhere under faults; its noise is the same."""
    usual, other = seen_at(simulated, name), seen_at(faulty, name)
    places = {tuple(index): pixel for index, pixel in zip(usual.index, usual.pixel, strict=True)}
    off = [p - places[tuple(i)] for i, p in zip(other.index, other.pixel, strict=True) if tuple(i) in places]
    return rms(off) if len(off) > 20 else np.inf


def test_every_photograph_of_the_session_is_read(simulated):
    session, reading = simulated.session, simulated.reading
    named = [*session.eyeball_camera.intrinsics, *session.tracking_camera.intrinsics]
    named += [each.path for each in (*session.bare, *session.tracking, *session.see_through)]
    assert set(reading.boards) == set(named)
    assert set(reading.panels) == {each.folder for each in session.display}
    assert all(20 < len(seen) <= 600 for seen in reading.boards.values())
    assert all(1000 < len(panel.samples) < 2000 for panel in reading.panels.values())


def test_readings_scatter_by_their_noise_about_the_true_projections(simulated):
    truth, session = simulated.truth, simulated.session
    for each, camera, target in zip(session.bare, truth.bare, truth.bare_targets, strict=True):
        seen = simulated.reading.boards[each.path]
        point = transforms.apply(transforms.inverse(camera) @ target, truth.bench.printed.point_of(seen.index))
        off = seen.pixel - truth.eyeball_at_target[each.target_pose].pixel_of_point(point)
        assert rms(off) == pytest.approx(0.02, rel=0.2)
        assert np.all(seen.sigma_px == 0.02)
    for each, camera in zip(session.display, truth.display, strict=True):
        samples = simulated.reading.panels[each.folder].samples
        exact = panel_position(truth.bench.optics, truth.bench.eyeball.camera, camera, samples.camera_pixel)
        assert rms(samples.panel_pixel - exact.value) == pytest.approx(0.03, rel=0.1)
        beside = panel_position(
            truth.bench.optics, truth.bench.eyeball.camera, camera, samples.camera_pixel + [1.0, 0.0]
        )
        wide = np.linalg.norm(beside.value - exact.value, axis=-1)
        assert np.nanmedian(samples.scale / wide) == pytest.approx(1.0, abs=0.1)


def test_noise_and_number_of_readings_are_options():
    options = ReadingOptions(dot_px=0.1, panel_px=0.2, most_dots=50, panel_samples=300)
    simulated = simulate_readings(RECIPE, options)
    seen = seen_at(simulated, "see_through/pose1_02.png")
    assert len(seen) <= 50
    assert np.all(seen.sigma_px == 0.1)
    panel = next(iter(simulated.reading.panels.values()))
    assert np.all(panel.samples.sigma_px == 0.2)
    assert 200 < len(panel.samples) < 400


@pytest.mark.slow  # renders 50 photographs
def test_photographs_of_the_same_bench_show_the_same(simulated, tmp_path):
    truth = simulated.truth
    plan = plan_photographs(truth.bench, RECIPE.viewpoints)
    visits = true_camera_poses(truth.bench, plan)
    of_photographs = simulate_readings(RECIPE, folder=tmp_path)
    session = of_photographs.session
    wanted = {session.folder / name for name in ("see_through/pose1_02.png", "bare/pose0_07.png")}
    wanted |= {session.tracking[1].path, session.tracking_camera.intrinsics[4]}
    for pose in camera_poses(session, truth.bench, plan, visits):
        boards = [each for each in pose.boards if each.path in wanted]
        panels = [each for each in pose.panels if each.folder == session.display[1].folder]
        if boards or panels:
            take(replace(pose, boards=boards, panels=panels))
    for path in wanted:
        found, said = session.board.find(read_photograph(path)), of_photographs.reading.boards[path]
        places = {tuple(index): pixel for index, pixel in zip(said.index, said.pixel, strict=True)}
        both = [tuple(index) in places for index in found.index]
        off = found.pixel[both] - [places[tuple(index)] for index in found.index[both]]
        assert len(off) > 0.6 * len(said)
        assert rms(off) < 0.05, path
        assert np.all(np.abs(off.mean(axis=0)) < 0.01), path
    folder = session.display[1].folder
    decoded = sample(session.pattern.decode(read_each(sorted(folder.iterdir())), session.decoding))
    exact = panel_position(truth.bench.optics, truth.bench.eyeball.camera, truth.display[1], decoded.camera_pixel).value
    off = (decoded.panel_pixel - exact)[np.isfinite(exact).all(axis=-1)]
    assert len(off) > 800
    assert np.all(np.abs(np.median(off, axis=0)) < 0.02)
    assert np.median(np.abs(off)) < 0.05


def test_the_session_states_the_readings_and_the_extrinsics_with_their_errors(simulated):
    session, truth = simulated.session, simulated.truth
    assert np.array_equal(session.device_from_tracking, truth.bench.stated_device_from_tracking)
    assert not np.allclose(session.device_from_tracking, truth.bench.device_from_tracking, atol=1e-5)
    assert session.tracking_sigma == pytest.approx((np.deg2rad(0.05), 0.3e-3))
    repeated = session.see_through[0], session.see_through[RECIPE.viewpoints]
    assert 0 < np.abs(repeated[0].stage - repeated[1].stage).max() < 5e-6
    assert np.array_equal(session.display[0].stage, session.see_through[0].stage)


def test_a_target_that_moved_before_the_headset_was_mounted_is_elsewhere_in_its_bare_photographs(simulated):
    faulty = simulate_readings(RECIPE, faults=Faults(board_moved=BoardMove(0, SHIFT)))
    assert moved_px(simulated, faulty, "bare/pose0_03.png") > 0.2
    for name in ("bare/pose1_03.png", "see_through/pose0_01.png", "tracking/pose0_before.png"):
        assert moved_px(simulated, faulty, name) == 0.0


def test_a_target_that_moved_in_its_sweep_stays_where_it_is_until_then(simulated):
    faulty = simulate_readings(RECIPE, faults=Faults(board_moved_in_sweep=BoardMove(0, SHIFT, visit=2)))
    for name in ("see_through/pose0_02.png", "see_through/pose0_04.png", "tracking/pose0_after.png"):
        assert moved_px(simulated, faulty, name) > 0.1
    for name in ("see_through/pose0_01.png", "see_through/pose1_03.png", "tracking/pose0_before.png"):
        assert moved_px(simulated, faulty, name) == 0.0


def test_a_headset_that_slipped_takes_its_optics_and_tracking_camera_along(simulated):
    faulty = simulate_readings(RECIPE, faults=Faults(headset_slipped=HeadsetSlip(0, 2, SHIFT)))
    for name in ("tracking/pose0_before.png", "see_through/pose0_01.png", "bare/pose1_03.png"):
        assert moved_px(simulated, faulty, name) == 0.0
    for name in ("tracking/pose0_after.png", "tracking/pose1_before.png"):
        assert moved_px(simulated, faulty, name) > 0.1
    truth, usual = faulty.truth, simulated.truth
    # Camera and target have not moved in the room.
    before, after = (transforms.inverse(t.see_through) @ t.see_through_targets for t in (usual, truth))
    np.testing.assert_allclose(after, before, atol=1e-12)
    slip = usual.see_through @ transforms.inverse(truth.see_through)
    np.testing.assert_allclose(slip[:2], np.broadcast_to(np.eye(4), (2, 4, 4)), atol=1e-12)
    np.testing.assert_allclose(slip[2:, :3, 3], np.broadcast_to(1e-3 * np.array(SHIFT.mm), (8, 3)), atol=1e-12)
    seen = [each.reading.panels[each.session.display[3].folder].samples for each in (simulated, faulty)]
    assert seen[0].panel_pixel.mean(axis=0) != pytest.approx(seen[1].panel_pixel.mean(axis=0), abs=0.5)


@pytest.mark.parametrize(("stage", "axes"), [("xy", 2), ("x", 1)])
def test_a_stage_of_fewer_axes_has_readings_of_those_alone(stage, axes):
    simulated = simulate_readings(replace(RECIPE, bench=replace(RECIPE.bench, stage=stage)))
    session, truth = simulated.session, simulated.truth
    entries = [*session.bare, *session.see_through, *session.display]
    assert {each.stage.shape for each in entries} == {(axes,)}
    assert len(session.stage.axes) == axes
    check_session(Table({}, "session.toml"), session)
    # Along the other axes the camera has not moved but for the errors of the stage.
    nominal = np.linalg.solve(
        truth.bench.stage_axes, (truth.see_through[:, :3, 3] - truth.bench.optics.eye_box.centre).T
    ).T
    assert np.abs(nominal[:, axes:]).max() < 0.1e-3
    assert np.abs(nominal[:, :axes]).max() > 2e-3


def test_a_camera_in_the_hand_sees_the_target_past_the_optics():
    bench = replace(RECIPE.bench, stage="hand", target_depths_m=(0.3, 0.5))
    simulated = simulate_readings(replace(RECIPE, bench=bench))
    session, truth = simulated.session, simulated.truth
    assert session.stage is None
    assert session.bare == ()
    check_session(Table({}, "session.toml"), session)
    assert len({each.place for each in session.see_through}) == len(session.see_through) == 2 * RECIPE.viewpoints
    assert [each.place for each in session.beside] == [each.place for each in session.see_through]
    turns = [truth.bench.device_from_camera[:3, :3].T @ pose[:3, :3] for pose in truth.see_through]
    degrees = np.rad2deg([np.arccos(0.5 * (np.trace(turn) - 1.0)) for turn in turns])
    assert 0.5 < degrees.mean() < 5.0
    box = truth.bench.optics.eye_box
    assert np.all(np.abs(truth.see_through[:, :3, 3] - box.centre) <= 0.5 * box.size + 1e-9)
    for each, camera, target in zip(session.beside, truth.see_through, truth.see_through_targets, strict=True):
        seen = simulated.reading.boards[each.path]
        point = transforms.apply(target, truth.bench.printed.point_of(seen.index))
        lens = truth.eyeball_at_target[each.target_pose]
        straight = lens.pixel_of_point(transforms.apply(transforms.inverse(camera), point))
        assert rms(seen.pixel - straight) == pytest.approx(0.02, rel=0.2)
        assert np.isnan(pixel_of_real_point(truth.bench.optics, lens, camera, point)).any(axis=-1).mean() > 0.95


def test_a_target_too_far_to_be_seen_past_the_optics_is_refused():
    with pytest.raises(BadInputError, match="bring the targets nearer"):
        simulate_readings(replace(RECIPE, bench=replace(RECIPE.bench, stage="hand")))


def test_exchanged_readings_are_exchanged_in_the_session_alone(simulated):
    faulty = simulate_readings(RECIPE, faults=Faults(exchanged=Exchange("see_through", 1, 3)))
    stages = [each.stage for each in simulated.session.see_through]
    stages[1], stages[3] = stages[3], stages[1]
    assert np.array_equal([each.stage for each in faulty.session.see_through], stages)
    assert moved_px(simulated, faulty, "see_through/pose0_01.png") == 0.0


def test_an_axis_off_its_right_angle_is_so_in_the_truth():
    recipe = replace(RECIPE, bench=replace(RECIPE.bench, imperfections=BenchImperfections.none()))
    axes = simulate_readings(recipe, faults=Faults(axis_off_deg=2.0)).truth.bench.stage_axes
    x, y = (axes[:, axis] / np.linalg.norm(axes[:, axis]) for axis in (0, 1))
    assert 90.0 - np.rad2deg(np.arccos(x @ y)) == pytest.approx(2.0, abs=0.01)


@pytest.mark.parametrize(
    "faults",
    [
        Faults(board_moved=BoardMove(7, SHIFT)),
        Faults(headset_slipped=HeadsetSlip(0, 99, SHIFT)),
        Faults(exchanged=Exchange("bare", 0, 99)),
        Faults(exchanged=Exchange("nothing", 0, 1)),
    ],
)
def test_faults_of_what_there_is_not_are_refused(faults):
    with pytest.raises(BadInputError, match="The fault is of"):
        simulate_readings(RECIPE, faults=faults)
