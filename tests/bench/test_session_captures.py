"""What calibration is given is, by the bench that is believed, where light truly goes."""

from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
from present import present
from scipy.spatial.transform import Rotation

from wlr_render.bench.bench import Bench, EyeballCamera, Stage, Target
from wlr_render.bench.session_captures import captures_of, see_through_captures, session_of
from wlr_render.bench.simulate_session import simulate
from wlr_render.captures.correspondences import Captures
from wlr_render.captures.session import DisplayPlan, Readings, SeeThroughPlan, Session, SessionPlan
from wlr_render.errors import BadInputError
from wlr_render.geometry.directions import ARCMIN, arcmin_between, dir_of_tangents
from wlr_render.geometry.transforms import rigid
from wlr_render.optics.device_file import load_device
from wlr_render.optics.traced_mappings import TracedDisplay, TracedSeeThrough

CAPTURES, ROWS = 4, 15
TIME_S = 300.0 * np.arange(CAPTURES)
TURN = Rotation.from_rotvec([0.01, -0.02, 0.015]).as_matrix()


@pytest.fixture(scope="module")
def bench() -> Bench:
    camera = EyeballCamera(np.array([1280.0, 1024.0]), np.array([1350.0, 1340.0]), np.array([640.5, 512.5]), 0.1)
    poses = rigid(np.eye(3), np.array([[0.03, 0.0, -0.6], [0.03, 0.0, -1.1]]))
    stage = Stage(np.array([0.032, 0.0, -0.033]))
    return Bench(load_device("northstar"), "right", camera, stage, Target(poses, np.full(2, 0.02)))


@pytest.fixture(scope="module")
def plan(bench: Bench) -> SessionPlan:
    rng = np.random.default_rng(3)
    capture = np.repeat(np.arange(CAPTURES), ROWS)
    stage = (bench.stage.origin + rng.uniform(-0.003, 0.003, (CAPTURES, 3)))[capture]
    travel = np.array([1.0, -1.0])[capture % 2]
    pixel = rng.uniform([500, 400], [800, 600], (len(capture), 2))
    display = DisplayPlan(
        capture, np.asarray(TIME_S[capture]), travel, stage, np.tile([0, 1, 2], len(capture) // 3), pixel
    )
    dot = rng.uniform(-0.1, 0.1, (len(capture), 2))
    pose = np.repeat([0, 1], len(capture) // 2)
    see_through = SeeThroughPlan(capture % 2, np.asarray(TIME_S[capture]), travel, stage, pose, dot)
    return SessionPlan(display, see_through)


def nothing(bench: Bench) -> Bench:
    return bench


def camera(**changes: Any) -> Callable[..., Any]:
    return lambda bench: replace(bench, camera=replace(bench.camera, **changes))


def stage(**changes: Any) -> Callable[..., Any]:
    return lambda bench: replace(bench, stage=replace(bench.stage, **changes))


def target(**changes: Any) -> Callable[..., Any]:
    return lambda bench: replace(bench, target=replace(bench.target, **changes))


def mount(**changes: Any) -> Callable[..., Any]:
    return lambda bench: replace(bench, mount=replace(bench.mount, **changes))


def readout(**changes: Any) -> Callable[..., Any]:
    return lambda bench: replace(bench, readout=replace(bench.readout, **changes))


def tracking(bench: Bench) -> Bench:
    return replace(bench, tracking=replace(bench.tracking, true_from_reported=rigid(TURN, np.array([1e-3, 0, 2e-3]))))


DISTURBANCES = {
    "nothing": nothing,
    "camera rotation": camera(device_from_camera=TURN),
    "camera lens": camera(distortion=np.array([0.03, -0.01])),
    "camera focal length": camera(focal_px=np.array([1360.0, 1335.0])),
    "camera pupil": camera(pupil_offset=np.array([1e-3, -5e-4, 2e-3])),
    "stage axes": stage(axes=np.eye(3) + 0.02 * np.arange(9).reshape(3, 3) / 9),
    "stage backlash": stage(backlash=np.array([1e-4, -2e-4])),
    "target scale": target(scale=np.array([1.004, 0.998])),
    "target bow": target(bow=np.array([[0.5, 0.2], [-0.3, 0.1]])),
    "tracking": tracking,
    "creep": mount(panel_creep=np.array([5e-5, -8e-5]), warm_up_s=400.0),
    "slip": mount(slip_time_s=450.0, slip=np.array([1e-3, 0, -1e-3]), slip_rotation=np.array([0.01, 0.02, -0.01])),
    "pixel origin": readout(origin_px=np.array([0.5, -1.0])),
    "lateral colour": readout(channel_scale=np.array([1.002, 1.0005, 0.998])),
}


@pytest.mark.parametrize("disturbance", [*DISTURBANCES, "all"])
def test_captures_of_a_bench_that_is_right_are_where_its_optics_send_light(
    bench: Bench, plan: SessionPlan, disturbance: str
) -> None:
    changes = DISTURBANCES.values() if disturbance == "all" else [DISTURBANCES[disturbance]]
    for change in changes:
        bench = change(bench)
    captures = captures_of(bench, Session("noise-free", plan, simulate(bench, plan))).in_colour()
    display, world = captures.display, captures.see_through
    assert display is not None
    shown, _ = TracedDisplay(bench.optics, bench.wavelengths_um[1]).plane_pixel(display.view_dir, display.viewpoint)
    np.testing.assert_allclose(shown, display.pixel, atol=1e-8)
    seen = TracedSeeThrough(bench.optics, bench.target_wavelength_um)
    assert world is not None
    assert arcmin_between(seen.view_dir_of_real_point(world.point, world.viewpoint).value, world.view_dir).max() < 1e-5
    assert len(display) == len(present(plan.display)) // 3
    assert len(world) == len(present(plan.see_through))


@pytest.mark.parametrize("disturbance", [*DISTURBANCES, "all"])
def test_observations_become_the_session_that_they_were_made_of(
    bench: Bench, plan: SessionPlan, disturbance: str
) -> None:
    for change in DISTURBANCES.values() if disturbance == "all" else [DISTURBANCES[disturbance]]:
        bench = change(bench)
    rng = np.random.default_rng(7)
    assert plan.display is not None
    turned = Rotation.from_rotvec(rng.normal(0, 0.02, (len(plan.display), 3))).as_matrix()
    assert plan.see_through is not None
    height = rng.normal(0, 1e-3, len(plan.see_through))
    plan = replace(
        plan,
        display=replace(plan.display, orientation=turned),
        see_through=replace(plan.see_through, orientation=turned, height=height),
    )
    session = Session("night", plan, simulate(bench, plan))
    found = session_of(bench, captures_of(bench, session), "night")
    for part in ("display", "see_through"):
        for field in fields(getattr(plan, part)):
            a, b = (getattr(getattr(each, part), field.name) for each in (found.plan, plan))
            assert (a is None) == (b is None), field.name
            if b is not None:
                np.testing.assert_allclose(a, b, atol=1e-11, err_msg=field.name)
    np.testing.assert_allclose(present(found.readings.panel_pixel), present(session.readings.panel_pixel), atol=1e-9)
    np.testing.assert_allclose(present(found.readings.dot_pixel), present(session.readings.dot_pixel), atol=1e-8)


def test_sigmas_of_readings_become_those_of_captures_and_back(bench: Bench, plan: SessionPlan) -> None:
    assert plan.display is not None
    sigma_px = np.random.default_rng(8).uniform(0.05, 0.3, (2, len(plan.display)))
    stated = SessionPlan(
        replace(plan.display, sigma_px=sigma_px[0]), replace(present(plan.see_through), sigma_px=sigma_px[1])
    )
    session = Session("night", stated, simulate(bench, plan))
    table, uniform = captures_of(bench, session), captures_of(bench, replace(session, plan=plan))
    for part, same, sigma in zip(table.both, uniform.both, sigma_px, strict=True):
        np.testing.assert_allclose(part.sigma_arcmin / same.sigma_arcmin, sigma / bench.camera.point_sigma_px)
    found = session_of(bench, table, "night").plan
    np.testing.assert_allclose(present(present(found.display).sigma_px), sigma_px[0])
    np.testing.assert_allclose(present(present(found.see_through).sigma_px), sigma_px[1])


def test_observations_of_another_eye_or_beside_the_targets_are_refused(bench: Bench, plan: SessionPlan) -> None:
    table = captures_of(bench, Session("night", plan, simulate(bench, plan)))
    with pytest.raises(BadInputError, match=r"night: the captures are of northstar \(right eye\), the bench is of"):
        session_of(replace(bench, eye="left"), table, "night")
    for poses, words in (
        (bench.target.device_from_target[:1], r"name target pose 1, but the bench has 1 \[\[target_pose\]\]"),
        (bench.target.device_from_target + rigid(np.zeros((3, 3)), np.array([0, 0, 0.1])), "lie up to 100 mm off"),
    ):
        moved = replace(bench, target=Target(poses, np.full(len(poses), 0.02)))
        with pytest.raises(BadInputError, match=words):
            session_of(moved, table, "night")
    behind = replace(bench, camera=replace(bench.camera, device_from_camera=np.diag([-1.0, 1.0, -1.0])))
    shown, seen = table.both
    nowhere = np.full((3, 3), np.nan)
    unrecorded = Captures(replace(shown, device_from_camera=nowhere), replace(seen, device_from_camera=nowhere))
    with pytest.raises(BadInputError, match="the camera looks back"):
        session_of(behind, unrecorded, "night")


def test_a_camera_that_was_turned_and_dots_on_the_bare_cameras_rays(bench: Bench, plan: SessionPlan) -> None:
    assert plan.see_through is not None
    count = len(plan.see_through)
    turned = Rotation.from_rotvec(np.random.default_rng(5).normal(0, 0.02, (count, 3))).as_matrix()
    rows = replace(plan.see_through, orientation=turned, bare_pixel=present(plan.display).camera_pixel)
    bench = DISTURBANCES["camera rotation"](DISTURBANCES["tracking"](bench))
    captures = see_through_captures(
        bench, present(rows), present(simulate(bench, SessionPlan(see_through=rows)).dot_pixel)
    )
    seen = TracedSeeThrough(bench.optics, bench.target_wavelength_um)
    answer = seen.view_dir_of_real_point(captures.point, captures.viewpoint).value
    assert arcmin_between(answer, captures.view_dir).max() < 1e-5


def test_photographs_are_numbered_on_from_pose_to_pose(bench: Bench, plan: SessionPlan) -> None:
    world = captures_of(bench, Session("night", plan, simulate(bench, plan))).see_through
    assert world is not None
    for number in np.unique(world.capture):
        rows = world.capture == number
        assert len(np.unique(present(plan.see_through).stage[rows], axis=0)) == 1
        assert len(np.unique(world.target_pose[rows])) == 1
    assert len(np.unique(world.capture)) == CAPTURES


def test_sigma_is_the_angle_of_a_camera_pixel(bench: Bench, plan: SessionPlan) -> None:
    captures = captures_of(bench, Session("night", plan, simulate(bench, plan))).in_colour()
    assert plan.display is not None
    green = plan.display.channel == 1
    pixel = plan.display.camera_pixel[green]
    tangents = (pixel - bench.camera.centre_px) / (bench.camera.focal_px * [1, -1])
    right, up = (
        arcmin_between(dir_of_tangents(tangents - step), dir_of_tangents(tangents + step))
        for step in (np.array([0.5 / 1350, 0]), np.array([0, 0.5 / 1340]))
    )
    per_pixel = np.sqrt(right * up)
    assert captures.display is not None
    np.testing.assert_allclose(captures.display.sigma_arcmin, 0.1 * per_pixel, rtol=2e-3)
    assert captures.display.sigma_arcmin.max() < 0.1 / 1340.0 / ARCMIN


def test_readings_that_are_missing_are_left_out(bench: Bench, plan: SessionPlan) -> None:
    readings = simulate(bench, plan)
    panel, dot = present(readings.panel_pixel).copy(), present(readings.dot_pixel).copy()
    panel[1], dot[:2, 0] = np.nan, np.nan
    captures = captures_of(bench, Session("night", plan, Readings(panel, dot))).in_colour()
    assert len(present(captures.display)) == CAPTURES * ROWS // 3 - 1
    assert len(present(captures.see_through)) == CAPTURES * ROWS - 2


def test_one_channel_alone_is_taken_whichever_it_is(bench: Bench, plan: SessionPlan) -> None:
    assert plan.display is not None
    red = replace(plan.display, channel=np.zeros_like(plan.display.channel))
    alone = SessionPlan(red)
    captures = captures_of(bench, Session("red", alone, simulate(bench, alone))).in_colour()
    assert len(present(captures.display)) == len(present(red))
    assert captures.see_through is None


def test_a_session_without_a_display_table_gives_see_through_alone(bench: Bench, plan: SessionPlan) -> None:
    alone = SessionPlan(see_through=plan.see_through)
    captures = captures_of(bench, Session("night", alone, simulate(bench, alone)))
    assert captures.display is None
    assert captures.source is captures.see_through
