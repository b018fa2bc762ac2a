"""One small bench and session for all tests of the procedure's parts."""

import numpy as np
import pytest
from small_session import measured, run_time_plan, small_bench, small_plan

from wlr_render.captures.session import SessionPlan
from wlr_render.diagnosis.extension import Predictor


@pytest.fixture(scope="session")
def bench():
    return small_bench()


@pytest.fixture(scope="session")
def plan(bench):
    """Display and see-through readings."""
    return small_plan(bench)


@pytest.fixture(scope="session")
def run_time(bench):
    """Run-time readings alone."""
    return SessionPlan(run_time=run_time_plan(bench))


@pytest.fixture(scope="session")
def clean(bench, plan):
    """Observations of a bench with nothing wrong, without noise."""
    return measured(bench, plan)


@pytest.fixture(scope="session")
def predictor(clean):
    """Of the clean observations."""
    return Predictor(clean)


@pytest.fixture(scope="session")
def everything(clean):
    """All readings count."""
    return np.ones(len(clean), dtype=bool)
