"""One small bench and session for all tests of the procedure's parts."""

from typing import Any

import numpy as np
import pytest
from diagnosis.small_session import (
    SIGMA_PX,
    diagnosed,
    measured,
    run_time_plan,
    small_bench,
    small_plan,
    with_moved_capture,
)
from numpy.typing import NDArray
from present import present

from wlr_render.bench.bench import Bench
from wlr_render.captures.session import SessionPlan
from wlr_render.diagnosis.observations import Observations
from wlr_render.diagnosis.prediction import Predictor
from wlr_render.diagnosis.report import Diagnosis


@pytest.fixture(scope="session")
def bench() -> Bench:
    return small_bench()


@pytest.fixture(scope="session")
def plan(bench: Bench) -> SessionPlan:
    """Display and see-through readings."""
    return small_plan(bench)


@pytest.fixture(scope="session")
def run_time(bench: Bench) -> SessionPlan:
    """Run-time readings alone."""
    return SessionPlan(run_time=run_time_plan(bench))


@pytest.fixture(scope="session")
def clean(bench: Bench, plan: SessionPlan) -> Observations:
    """Observations of a bench with nothing wrong, without noise."""
    return measured(bench, plan)


@pytest.fixture(scope="session")
def predictor(clean: Observations) -> Predictor:
    """Of the clean observations."""
    return Predictor(clean)


@pytest.fixture(scope="session")
def everything(clean: Observations) -> NDArray[Any]:
    """All readings count."""
    return np.ones(len(clean), dtype=bool)


@pytest.fixture(scope="session")
def explained(bench: Bench, plan: SessionPlan) -> Diagnosis:
    """Diagnosis of a session with a tilted combiner, a target printed too large, and a display capture that moved."""
    truth = {"combiner_tilt": [0.3, -0.2, 0.3], "target_scale": [0.3, 0.3]}
    observations = with_moved_capture(measured(bench, plan, SIGMA_PX, seed=4, **truth), bench, 3)
    return diagnosed(observations, ("combiner_tilt", "target_scale", "tracking_translation", "panel_shift"))


@pytest.fixture(scope="session")
def located(bench: Bench, plan: SessionPlan) -> Diagnosis:
    """Diagnosis of a session whose panel is bent in waves, and whose noise is twice what is stated."""
    observations = measured(bench, plan, 2 * SIGMA_PX, seed=5)
    read = observations.session.readings
    present(read.panel_pixel)[:, 0] += 4.0 * np.sin(2 * np.pi * present(read.panel_pixel)[:, 0] / 500)
    return diagnosed(observations, ("target_scale", "stage_scale"))


@pytest.fixture(scope="session")
def nothing(bench: Bench, plan: SessionPlan) -> Diagnosis:
    """Diagnosis of a session with nothing wrong."""
    return diagnosed(measured(bench, plan, SIGMA_PX, seed=6), ("target_scale", "combiner_tilt"))


@pytest.fixture(scope="session")
def late(bench: Bench, run_time: SessionPlan) -> Diagnosis:
    """Diagnosis of run-time readings with a latency of 11 ms."""
    return diagnosed(measured(bench, run_time, SIGMA_PX, seed=7, latency=[11.0]), ("latency", "eye_position_bias"))
