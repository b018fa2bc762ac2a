"""What an explanation is worth: station causes spoil models, device causes spoil the prescription."""

from dataclasses import replace

import numpy as np
import pytest
from present import present
from scipy.spatial.transform import Rotation

from wlr_render.bench.bench import Bench, EyeballCamera, Stage, Target
from wlr_render.bench.simulate_session import simulate
from wlr_render.captures.session import DisplayPlan, Readings, SeeThroughPlan, Session, SessionPlan, select_rows
from wlr_render.diagnosis.improvement import improvement_in_use
from wlr_render.geometry.transforms import rigid
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.device_file import load_device

CAPTURES, ROWS = 25, 40
SIGMA_PX = 0.1
NOISE_ARCMIN = np.sqrt(2) * SIGMA_PX / 1350 * 60 * np.rad2deg(1)


@pytest.fixture(scope="module")
def nominal() -> Bench:
    size = np.array([1280.0, 1024.0])
    camera = EyeballCamera(size, np.full(2, 1350.0), size / 2, SIGMA_PX)
    device = load_device("northstar")
    centre = device.eyes["right"].eye_box.centre
    poses = rigid(np.eye(3), centre + np.array([[0.0, 0.0, -0.6], [0.0, 0.0, -1.2]]))
    return Bench(device, "right", camera, Stage(centre), Target(poses, np.full(2, 0.02)))


@pytest.fixture(scope="module")
def plan(nominal: Bench) -> SessionPlan:
    rng = np.random.default_rng(7)
    capture = np.repeat(np.arange(CAPTURES), ROWS)
    # Wider than the eye box, which is deep: rays through its corners meet the plane outside it.
    stage = (nominal.stage.origin + rng.uniform(-0.007, 0.007, (CAPTURES, 3)) * [1, 1, 0])[capture]
    pixel = rng.uniform([300, 220], [980, 800], (len(capture), 2))
    common = (capture, np.asarray(40.0 * capture), np.ones(len(capture)), stage)
    display = DisplayPlan(*common, np.ones_like(capture), pixel)
    pose = capture % 2
    dot = rng.uniform(-0.16, 0.16, (len(capture), 2)) * (1 + pose[:, None])
    return SessionPlan(display, SeeThroughPlan(*common, pose, dot))


def measured(true: Bench, plan: SessionPlan) -> Session:
    """A session on the true bench, with noise: of camera pixels, for the panel too."""
    rng = np.random.default_rng(11)
    assert plan.display is not None
    kick = rng.normal(0, SIGMA_PX, (len(plan.display), 2))
    ahead = replace(plan.display, camera_pixel=plan.display.camera_pixel + kick)
    panel = simulate(true, SessionPlan(ahead)).panel_pixel
    dot = simulate(true, SessionPlan(see_through=plan.see_through)).dot_pixel
    assert dot is not None
    return Session("night", plan, Readings(panel, dot + rng.normal(0, SIGMA_PX, dot.shape)))


def moved_surfaces(bench: Bench, move: FloatArray) -> Bench:
    optics = bench.optics.with_surfaces(lambda s: replace(s, device_from_surface=move @ s.device_from_surface))
    return replace(bench, device=replace(bench.device, eyes={"right": optics}))


@pytest.mark.slow
def test_a_stage_that_went_too_far_spoils_models_without_their_knowing(nominal: Bench, plan: SessionPlan) -> None:
    true = replace(nominal, stage=Stage(nominal.stage.origin, 1.05 * np.eye(3)))
    found = improvement_in_use(nominal, true, measured(true, plan))
    for part in (found.display, found.see_through):
        assert part is not None
        assert part.after < part.before
        assert part.improvement.percent == pytest.approx(100 * (1 - part.after / part.before))
    assert present(found.display).improvement.significance > 3
    assert found.calibrated is not None
    assert found.calibrated.after.median < 0.5 * found.calibrated.before.median
    assert found.prescribed is not None
    assert found.prescribed.after == found.prescribed.before
    assert found.unavailable == ()


def test_a_turned_combiner_is_absorbed_by_models_and_spoils_the_prescription(nominal: Bench, plan: SessionPlan) -> None:
    turn = Rotation.from_rotvec([np.deg2rad(0.3), 0, 0]).as_matrix()
    pivot = nominal.optics.eye_box.centre
    true = moved_surfaces(nominal, rigid(turn, pivot - turn @ pivot))
    found = improvement_in_use(nominal, true, measured(true, plan))
    assert present(found.display).improvement.percent == 0.0
    assert present(found.display).after < 1.5 * NOISE_ARCMIN
    assert 0.9 * NOISE_ARCMIN < present(found.see_through).after < 1.1 * NOISE_ARCMIN
    assert found.calibrated is not None
    assert found.calibrated.before == found.calibrated.after
    assert found.calibrated.after.median < 0.5 * NOISE_ARCMIN
    assert found.prescribed is not None
    assert found.prescribed.before.median > 10
    assert found.prescribed.after.median < 0.5 * NOISE_ARCMIN


def test_points_tracked_at_an_angle_are_missed_by_that_angle(nominal: Bench, plan: SessionPlan) -> None:
    turn = Rotation.from_rotvec([0, np.deg2rad(0.1), 0]).as_matrix()
    pivot = nominal.optics.eye_box.centre
    true = replace(nominal, tracking=replace(nominal.tracking, true_from_reported=rigid(turn, pivot - turn @ pivot)))
    found = improvement_in_use(nominal, true, measured(true, plan))
    # Models that were told points 0.1 degrees beside where they are light pixels as far beside those that are meant.
    assert found.calibrated is not None
    assert found.calibrated.before.median == pytest.approx(6.0, rel=0.05)
    assert found.calibrated.after.median < 0.5 * NOISE_ARCMIN


@pytest.mark.parametrize(("missing", "table"), [("display", "display"), ("see_through", "seethrough")])
def test_what_a_session_does_not_have_is_named_and_left_out(
    nominal: Bench, plan: SessionPlan, missing: str, table: str
) -> None:
    few = {name: select_rows(rows, rows.capture < 9) for name, rows in vars(plan).items() if rows is not None}
    part = SessionPlan(**few | {missing: None})
    found = improvement_in_use(nominal, nominal, Session("night", part, simulate(nominal, part)))
    assert getattr(found, missing) is None
    assert (found.display is None) != (found.see_through is None)
    assert found.calibrated is None
    assert found.prescribed is None
    assert len(found.unavailable) == 1
    assert f"night: has no {table} table" in found.unavailable[0]


def test_targets_at_one_depth_determine_no_see_through_model(nominal: Bench, plan: SessionPlan) -> None:
    seen = present(plan.see_through)
    near = select_rows(seen, seen.target_pose == 0)
    alone = SessionPlan(see_through=near)
    found = improvement_in_use(nominal, nominal, Session("night", alone, simulate(nominal, alone)))
    assert found.see_through is None
    assert any("all real points are of one target pose" in sentence for sentence in found.unavailable)
