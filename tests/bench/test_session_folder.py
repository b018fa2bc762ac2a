"""Session folders: saved and loaded alike, checked against their bench, and in agreement with a measured session."""

from collections.abc import Callable, Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from present import present
from scipy.spatial.transform import Rotation

from wlr_render.bench.bench import Bench, EyeballCamera, Stage, Target
from wlr_render.bench.session_folder import check_enough_captures, load_session, save_session
from wlr_render.bench.simulate_session import simulate
from wlr_render.captures.session import (
    DisplayPlan,
    Readings,
    RunTimePlan,
    SeeThroughPlan,
    Session,
    SessionPlan,
    select_rows,
)
from wlr_render.captures.session_schema import RUN_TIME
from wlr_render.captures.session_tables import read_table
from wlr_render.errors import BadInputError
from wlr_render.geometry.directions import dir_of_tangents
from wlr_render.geometry.transforms import rigid
from wlr_render.optics.device_file import load_device

MEASURED = Path(__file__).resolve().parents[3] / "shared" / "measured"
CAPTURES, ROWS = 4, 20


@pytest.fixture(scope="module")
def bench() -> Bench:
    camera = EyeballCamera(
        np.array([1280.0, 1024.0]),
        np.array([1350.0, 1340.0]),
        np.array([640.5, 512.0]),
        0.1,
        np.array([0.02, -0.01]),
        Rotation.from_rotvec([0.01, 0.02, -0.01]).as_matrix(),
    )
    poses = rigid(np.eye(3), np.array([[0.03, 0.0, -0.6], [0.03, 0.0, -1.1]]))
    return Bench(
        load_device("northstar"),
        "right",
        camera,
        Stage(np.array([0.032, 0.0, -0.033])),
        Target(poses, np.full(2, 0.02)),
    )


@pytest.fixture(scope="module")
def session(bench: Bench) -> Session:
    rng = np.random.default_rng(8)
    capture = np.repeat(np.arange(CAPTURES), ROWS)
    time_s = 40.0 * capture
    stage = (bench.stage.origin + rng.uniform(-0.004, 0.004, (CAPTURES, 3)))[capture]
    travel = np.array([1.0, -1.0])[capture % 2]
    pixel = rng.uniform([400, 300], [900, 700], (len(capture), 2))
    sigma_px = rng.uniform(0.05, 0.3, len(capture))
    display = DisplayPlan(capture, np.asarray(time_s), travel, stage, capture % 3, pixel, sigma_px=sigma_px)
    turned = Rotation.from_rotvec(rng.normal(0, 0.02, (CAPTURES, 3))).as_matrix()[capture]
    dot = rng.uniform(-0.1, 0.1, (len(capture), 2))
    see_through = SeeThroughPlan(
        capture, np.asarray(time_s), travel, stage, capture % 2, dot, pixel, orientation=turned
    )
    count = len(capture)
    head = rigid(Rotation.random(count, rng=rng).as_matrix(), rng.normal(0, 1, (count, 3)))
    gaze = dir_of_tangents(rng.uniform(-0.2, 0.2, (count, 2)))
    at = np.einsum("nij,nj->ni", head[:, :3, :3], [0.032, 0.0, -0.033] + 0.8 * gaze) + head[:, :3, 3]
    velocity, rate = rng.normal(0, 0.1, (2, count, 3))
    run_time = RunTimePlan(capture, np.asarray(np.arange(count) * 0.1), head, velocity, rate, stage, gaze, at)
    plan = SessionPlan(display, see_through, run_time)
    return Session("night", plan, simulate(bench, plan))


def assert_same(
    found: DisplayPlan | Readings | RunTimePlan | SeeThroughPlan,
    expected: DisplayPlan | Readings | RunTimePlan | SeeThroughPlan,
) -> None:
    for field in fields(expected):
        a, b = getattr(found, field.name), getattr(expected, field.name)
        assert (a is None) == (b is None), field.name
        if b is not None:
            np.testing.assert_allclose(a, b, rtol=1e-11, atol=1e-11, err_msg=field.name)


def test_what_is_saved_is_loaded_but_for_rows_without_a_reading(tmp_path: Path, bench: Bench, session: Session) -> None:
    assert np.isfinite(present(session.readings.run_time_pixel)).all(axis=1).mean() > 0.5
    seen = {
        name: np.isfinite(getattr(session.readings, name)).all(axis=1)
        for name in ("panel_pixel", "dot_pixel", "run_time_pixel")
    }
    _, loaded = load_session(save_session(tmp_path / "night", bench, session))
    assert loaded.name == "night"
    for part, reading in (("display", "panel_pixel"), ("see_through", "dot_pixel"), ("run_time", "run_time_pixel")):
        rows = seen[reading]
        assert_same(getattr(loaded.plan, part), select_rows(getattr(session.plan, part), rows))
        np.testing.assert_allclose(
            getattr(loaded.readings, reading), getattr(session.readings, reading)[rows], rtol=1e-11, atol=1e-11
        )


def test_a_loaded_bench_predicts_what_was_saved(tmp_path: Path, bench: Bench, session: Session) -> None:
    loaded_bench, loaded = load_session(save_session(tmp_path, bench, session))
    assert_same(simulate(loaded_bench, loaded.plan), loaded.readings)


def test_run_time_pixels_are_written_as_measured_whatever_camera_is_saved_with_them(
    tmp_path: Path, bench: Bench, session: Session
) -> None:
    rows = np.asarray(np.isfinite(present(session.readings.run_time_pixel)).all(axis=1))
    measured = np.random.default_rng(3).uniform(100, 1100, (rows.sum(), 4)).round(3)
    plan = SessionPlan(run_time=select_rows(present(session.plan.run_time), rows))
    save_session(tmp_path / "measured", bench, Session("night", plan, Readings(run_time_pixel=measured)))
    read = load_session(tmp_path / "measured")[1]
    np.testing.assert_array_equal(read.readings.run_time_pixel, measured)
    camera = replace(bench.camera, distortion=np.zeros(2), focal_px=1.01 * bench.camera.focal_px)
    save_session(tmp_path / "corrected", replace(bench, camera=camera), read)
    for name in ("measured", "corrected"):
        table = read_table(tmp_path / name / "runtime.csv.gz", RUN_TIME)
        found = np.stack([table[f"{dot}_{axis}"] for dot in ("virtual", "real") for axis in "uv"], axis=1)
        np.testing.assert_array_equal(found, (measured - 0.5).round(3))


def only_display(session: Session, **changes: Any) -> Session:
    plan = replace(present(session.plan.display), **changes)
    return Session(session.name, SessionPlan(display=plan), Readings(panel_pixel=session.readings.panel_pixel))


def test_a_session_may_have_one_table_and_no_stale_ones(tmp_path: Path, bench: Bench, session: Session) -> None:
    save_session(tmp_path, bench, only_display(session))
    assert load_session(tmp_path)[1].plan.see_through is None
    save_session(tmp_path, bench, session)
    with pytest.raises(BadInputError, match=r"seethrough\.csv\.gz: is not of the session to be written"):
        save_session(tmp_path, bench, only_display(session))


def test_a_folder_without_tables_or_with_one_twice_is_refused(tmp_path: Path, bench: Bench, session: Session) -> None:
    save_session(tmp_path, bench, only_display(session))
    packed = tmp_path / "display.csv.gz"
    packed.with_suffix("").write_text("", encoding="utf-8")
    with pytest.raises(BadInputError, match=r"has both display\.csv and display\.csv\.gz; remove one"):
        load_session(tmp_path)
    packed.with_suffix("").unlink()
    packed.unlink()
    with pytest.raises(BadInputError, match=r"has none of the tables display\.csv, seethrough\.csv, runtime\.csv"):
        load_session(tmp_path)
    with pytest.raises(
        BadInputError, match=r"nowhere: has no bench\.toml, so it is not a bench session; .*bench-session\.md has"
    ):
        load_session(tmp_path / "nowhere")


@pytest.mark.parametrize(
    ("damage", "sentence"),
    [
        (
            lambda display: {"stage": display.stage * 30},
            "the distance of the stage from 'origin' in the display table has",
        ),
        (
            lambda display: {"stage": 1e-3 * display.stage + [0.032, 0, -0.033]},
            "mm in the display table; are its readings",
        ),
        (
            lambda display: {"stage": display.stage * [1e-3, 1, 1]},
            "stage_x_mm in the display table is 0.03.* in metres",
        ),
        (lambda display: {"camera_pixel": display.camera_pixel + 5000}, "the display table has the camera pixel"),
        (
            lambda display: {"camera_pixel": 0 * display.camera_pixel + 500},
            "the camera pixels in the display table are",
        ),
        (lambda display: {"sigma_px": 1e-12 * display.sigma_px}, "'sigma_px' is .*; it must be 1e-06 px or more"),
    ],
    ids=["micrometres", "metres", "one axis in metres", "camera pixel", "one camera pixel", "sigma"],
)
def test_readings_that_the_bench_cannot_have_taken_are_refused(
    tmp_path: Path, bench: Bench, session: Session, damage: Callable[..., Any], sentence: str
) -> None:
    damaged = replace(present(session.plan.display), **damage(session.plan.display))
    save_session(tmp_path, bench, replace(session, plan=replace(session.plan, display=damaged)))
    with pytest.raises(BadInputError, match=sentence):
        load_session(tmp_path)


@pytest.mark.parametrize(
    ("part", "changes", "sentence"),
    [
        ("camera", {"focal_px": np.array([1350.0, 135.0])}, r"focal length \(fx, fy\) is .* no camera's two differ"),
        ("camera", {"focal_px": np.array([8.0, 8.0])}, "not in millimetres"),
        ("camera", {"centre_px": np.array([64050.0, 512.0])}, r"principal point \(cx, cy\) .* far outside"),
        ("camera", {"point_sigma_px": 1e-12}, "'point_sigma_px' has the value 1e-12; it must be 1e-06 or more"),
        (
            "target",
            {"pitch": np.array([2e-5, 2e-5])},
            r"\[\[target_pose\]\] number 1 .* 'pitch_mm' is 0.02, but the dots",
        ),
        (
            "target",
            {"device_from_target": rigid(np.eye(3), np.zeros((2, 3)))},
            "number 1 .* 'translation' is not 30 mm",
        ),
    ],
)
def test_benches_that_nobody_has_are_refused(
    tmp_path: Path, bench: Bench, session: Session, part: str, changes: Mapping[str, Any], sentence: str
) -> None:
    save_session(tmp_path, replace(bench, **{part: replace(getattr(bench, part), **changes)}), session)
    with pytest.raises(BadInputError, match=sentence):
        load_session(tmp_path)


def test_a_camera_on_the_other_side_of_the_head_is_refused(tmp_path: Path, bench: Bench, session: Session) -> None:
    save_session(tmp_path, bench, session)
    file = tmp_path / "bench.toml"
    file.write_text(file.read_text(encoding="utf-8").replace('eye = "right"', 'eye = "left"'), encoding="utf-8")
    with pytest.raises(BadInputError, match=r"stage_x_mm in the display table is .* but the left eye of northstar"):
        load_session(tmp_path)


def test_a_link_that_leads_nowhere_is_not_a_table_left_out(tmp_path: Path, bench: Bench, session: Session) -> None:
    save_session(tmp_path, bench, only_display(session))
    (tmp_path / "seethrough.csv").symlink_to("seethrough.csv")
    with pytest.raises(BadInputError, match=r"seethrough\.csv: cannot be read"):
        load_session(tmp_path)


def test_a_panel_of_another_device_is_refused(tmp_path: Path, bench: Bench, session: Session) -> None:
    beside = Readings(panel_pixel=present(session.readings.panel_pixel) + [5000.0, 0.0])
    save_session(tmp_path, bench, replace(only_display(session), readings=beside))
    with pytest.raises(
        BadInputError, match=r"northstar, display table: 100.0% of the panel pixels are outside the panel"
    ):
        load_session(tmp_path)


def test_a_pose_that_the_bench_does_not_have_is_refused(tmp_path: Path, bench: Bench, session: Session) -> None:
    target = Target(bench.target.device_from_target[:1], bench.target.pitch[:1])
    save_session(tmp_path, replace(bench, target=target), session)
    with pytest.raises(BadInputError, match=r"names target_pose 1, but its bench has 1 \[\[target_pose\]\]"):
        load_session(tmp_path)


def test_captures_to_hold_out_are_counted_over_all_tables(session: Session) -> None:
    check_enough_captures(session)
    with pytest.raises(BadInputError, match=r"night: has 4 captures, too few captures to hold any out"):
        check_enough_captures(only_display(session))


@pytest.mark.skipif(not MEASURED.is_dir(), reason="the measured sessions are not beside this checkout")
class TestMeasured:
    @pytest.mark.parametrize("name", [f"M{number}" for number in range(1, 7)])
    def test_every_measured_session_loads(self, name: str) -> None:
        _, session = load_session(MEASURED / name)
        assert len(np.unique(present(session.plan.display).capture)) == 48
        assert len(present(session.plan.see_through)) == 15120

    def test_the_session_with_nothing_wrong_is_predicted_to_its_noise(self) -> None:
        """The noise of a decoded panel position is the camera's, carried to the panel."""
        bench, session = load_session(MEASURED / "M3")
        found = simulate(bench, session.plan)
        sigma_px = bench.camera.point_sigma_px
        off_target = present(session.readings.dot_pixel) - present(found.dot_pixel)
        assert np.sqrt(np.mean(off_target**2)) == pytest.approx(sigma_px, rel=0.02)
        variance = np.zeros_like(found.panel_pixel)
        for step in ([0.5, 0.0], [0.0, 0.5]):
            assert session.plan.display is not None
            low, high = (
                replace(session.plan.display, camera_pixel=session.plan.display.camera_pixel + sign * np.array(step))
                for sign in (-1, 1)
            )
            slope = present(simulate(bench, SessionPlan(high)).panel_pixel) - present(
                simulate(bench, SessionPlan(low)).panel_pixel
            )
            variance += (sigma_px * slope) ** 2
        off_panel = (present(session.readings.panel_pixel) - present(found.panel_pixel)) / np.sqrt(variance)
        assert np.sqrt(np.mean(off_panel**2)) == pytest.approx(1.0, rel=0.02)
