"""One small bench and session for all tests of the procedure's parts."""

from typing import Any

import numpy as np
import pytest
from diagnosis import small_session as sessions
from diagnosis.small_session import (
    SIGMA_PX,
    diagnosed,
    measured,
    run_time_plan,
    small_bench,
    small_plan,
)
from memo import memoised, shared_folder
from numpy.typing import NDArray

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
def explained(tmp_path_factory: pytest.TempPathFactory) -> Diagnosis:
    """Diagnosis of a session with a tilted combiner, a target printed too large, and a display capture that moved."""
    return memoised(sessions.explained, shared_folder(tmp_path_factory))()


@pytest.fixture(scope="session")
def located(tmp_path_factory: pytest.TempPathFactory) -> Diagnosis:
    """Diagnosis of a session whose panel is bent in waves, and whose noise is twice what is stated."""
    return memoised(sessions.located, shared_folder(tmp_path_factory))()


@pytest.fixture(scope="session")
def nothing(bench: Bench, plan: SessionPlan) -> Diagnosis:
    """Diagnosis of a session with nothing wrong."""
    return diagnosed(measured(bench, plan, SIGMA_PX, seed=6), ("target_scale", "combiner_tilt"))


@pytest.fixture(scope="session")
def late(bench: Bench, run_time: SessionPlan) -> Diagnosis:
    """Diagnosis of run-time readings with a latency of 11 ms."""
    return diagnosed(measured(bench, run_time, SIGMA_PX, seed=7, latency=[11.0]), ("latency", "eye_position_bias"))
