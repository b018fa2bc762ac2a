"""Run-time sessions with a hidden effect: closed forms, and the package's own simulation of the same glasses."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from oracle.captures import CAMERA_CENTRE_PX, CAMERA_FOCAL_PX, CAMERA_SIZE_PX
from oracle.devices import NAMES
from oracle.effects import UNLISTED_AT_RUN_TIME, Effect, draw_effect
from oracle.run_time import RunTimePlan, RunTimeSession, observe_run_time
from oracle.session_writer import write_run_time_session
from wlr_render.bench.session_folder import load_session
from wlr_render.bench.simulate_session import simulate
from wlr_render.diagnosis.prediction import Predictor
from wlr_render.numerics.arrays import FloatArray

QUIET = RunTimePlan(recordings=6, moments=20, sigma_px=0.0)


def see(*effects: Effect, plan: RunTimePlan = QUIET) -> RunTimeSession:
    return observe_run_time(plan, effects, np.random.default_rng(5))


def gap(*effects: Effect, plan: RunTimePlan = QUIET) -> FloatArray:
    """By how much the virtual dot misses the real one, (n, 2) pixels, where both are seen."""
    session = see(*effects, plan=plan)
    return session.virtual - session.real


@pytest.mark.parametrize("device", NAMES)
def test_without_an_effect_the_virtual_dot_covers_the_real_one(device: str) -> None:
    session = see(plan=replace(QUIET, device=device))
    seen = np.isfinite(session.virtual[:, 0])
    assert seen.mean() > 0.4
    np.testing.assert_allclose(session.virtual[seen], session.real[seen], rtol=0, atol=1e-6)


@pytest.mark.parametrize("name", UNLISTED_AT_RUN_TIME)
def test_no_size_is_no_effect_and_a_size_is_one_although_it_may_act_on_few_of_the_dots(name: str) -> None:
    assert np.nanmax(np.abs(gap(draw_effect(name, np.random.default_rng(4), 0.0)))) < 1e-6
    assert np.nanquantile(np.abs(gap(draw_effect(name, np.random.default_rng(4), 3.0))), 0.9) > 0.3


def test_a_row_of_the_camera_is_as_late_as_a_latency_of_its_own() -> None:
    duration_ms = 12.0
    rolled, clean = gap(Effect("camera_shutter", {"duration_ms": duration_ms})), see()
    latency = gap(Effect("latency", {"latency_ms": duration_ms}))
    seen = np.isfinite(rolled).all(axis=1) & (np.linalg.norm(latency, axis=1) > 1.0)
    share = np.sum(rolled * latency, axis=1)[seen] / np.sum(latency**2, axis=1)[seen]
    row = clean.real[seen, 1] / CAMERA_SIZE_PX[1]
    assert np.ptp(row) > 0.2
    np.testing.assert_allclose(share, row, atol=0.02)


def test_a_band_of_rows_is_late_and_the_others_are_not() -> None:
    late = gap(Effect("band_delay", {"late_ms": 8.0, "row": 0.5, "width": 0.3}))
    whole = gap(Effect("latency", {"latency_ms": 8.0}))
    seen = np.isfinite(late).all(axis=1) & (np.linalg.norm(whole, axis=1) > 1.0)
    is_late = np.linalg.norm(late[seen], axis=1) > 1e-6
    np.testing.assert_allclose(late[seen][is_late], whole[seen][is_late], atol=1e-9)
    assert 0.1 < is_late.mean() < 0.9


def test_a_hinge_turns_the_picture_by_gravity_and_leaves_the_real_dot() -> None:
    before, after = see(), see(Effect("hinge_flex", {"x_deg": 0.2, "y_deg": 0.0, "z_deg": 0.0}))
    np.testing.assert_array_equal(after.real, before.real)
    along_sight = before.motion.axes[:, 1, 2]
    tangent = (before.virtual[:, 1] - CAMERA_CENTRE_PX[1]) / CAMERA_FOCAL_PX
    expected = -CAMERA_FOCAL_PX * np.radians(0.2) * along_sight * (1.0 + tangent**2)
    seen = np.isfinite(expected)
    np.testing.assert_allclose((after.virtual - before.virtual)[seen, 1], expected[seen], atol=5e-3)
    assert np.ptp(expected[seen]) > 1.0


@pytest.mark.parametrize("device", NAMES)
def test_the_package_reads_what_is_written_and_predicts_it(tmp_path: Path, device: str) -> None:
    plan = RunTimePlan(device, recordings=6, moments=40, sigma_px=0.1)
    write_run_time_session(tmp_path, plan, [], np.random.default_rng(1))
    nominal, session = load_session(tmp_path)
    observations = Predictor.of_session(nominal, session).observations
    residual = observations.residual(simulate(nominal, observations.session.plan))
    assert len(residual) > 100
    assert np.sqrt(np.mean(residual**2)) == pytest.approx(1.0, abs=0.1)
