"""The smallest effects that a session would have shown."""

import numpy as np
import pytest
from small_session import SIGMA_PX, explanation, measured

from wlr_render.diagnosis.causes import CAUSES
from wlr_render.diagnosis.fit import fit
from wlr_render.diagnosis.prediction import Explanation, Predictor
from wlr_render.diagnosis.procedure import detection_limits


@pytest.fixture(scope="module")
def noisy(bench, plan):
    return measured(bench, plan, SIGMA_PX, seed=11)


def limits_of(observations, causes=CAUSES, share=1.0):
    thin = observations.spread(int(share * len(observations)))
    predictor = Predictor(observations.of_rows(thin))
    found = detection_limits(predictor, np.ones(thin.sum(), dtype=bool), np.ones(len(observations), dtype=bool), causes)
    return {(limit.cause, limit.parameter): limit.limit for limit in found}


def test_every_cause_that_the_session_can_show_has_a_limit(noisy):
    found = limits_of(noisy)
    run_time = {name for name, cause in CAUSES.items() if cause.part in ("eye tracking", "clock")}
    assert {cause for cause, _ in found} == set(CAUSES) - run_time
    assert all(0 < smallest < np.inf for smallest in found.values())
    units = {(name, p.name) for name, cause in CAUSES.items() for p in cause.parameters}
    assert set(found) <= units


def test_an_effect_of_that_size_is_five_standard_errors_when_it_is_there(bench, plan, noisy):
    for name in ("panel_scale", "camera_focal_length", "stage_backlash"):
        ((_, smallest),) = limits_of(noisy, {name: CAUSES[name]}).items()
        observations = measured(bench, plan, SIGMA_PX, seed=12, **{name: [smallest]})
        predictor, used = Predictor(observations), np.ones(len(observations), dtype=bool)
        before, after = (fit(predictor, start, used) for start in (Explanation(), explanation(**{name: [0.0]})))
        assert np.sqrt(before.chi_squared - after.chi_squared) == pytest.approx(5.0, abs=3.0)
        assert after.sigmas()[0] == pytest.approx(smallest / 5, rel=0.01)


def test_a_part_of_the_readings_stands_for_all(noisy):
    names = ("combiner_tilt", "target_scale", "panel_shift")
    causes = {name: CAUSES[name] for name in names}
    whole, third = limits_of(noisy, causes), limits_of(noisy, causes, 1 / 3)
    for key, smallest in whole.items():
        assert third[key] == pytest.approx(smallest, rel=0.15)
