"""The smallest effects that a session would have shown."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from diagnosis.small_session import SIGMA_PX, explanation, fitted, measured, weighed, with_jitter
from present import present

from wlr_render.bench.bench import Bench
from wlr_render.captures.session import SessionPlan
from wlr_render.diagnosis.cause_selection import Search
from wlr_render.diagnosis.causes import CAUSES
from wlr_render.diagnosis.findings import detection_limits
from wlr_render.diagnosis.fit import fit
from wlr_render.diagnosis.observations import Observations
from wlr_render.diagnosis.prediction import Explanation
from wlr_render.numerics.scatter import Scatter


@pytest.fixture(scope="module")
def noisy(bench: Bench, plan: SessionPlan) -> Observations:
    return measured(bench, plan, SIGMA_PX, seed=11)


def limits_of(observations: Observations, causes: Mapping[Any, Any] = CAUSES, share: float = 1.0) -> dict[Any, Any]:
    full = weighed(observations)
    search = Search(full, full.of_rows(observations.spread(int(share * len(observations)))), ())
    nothing = fit(full, Explanation(), Scatter.usual(len(observations.captures)))
    found = detection_limits(search, present(nothing), causes)
    return {(limit.cause, limit.parameter): limit.limit for limit in found}


@pytest.mark.slow
def test_every_cause_that_the_session_can_show_has_a_limit(noisy: Observations) -> None:
    found = limits_of(noisy)
    run_time = {name for name, cause in CAUSES.items() if cause.part in ("eye tracking", "clock")}
    assert {cause for cause, _ in found} == set(CAUSES) - run_time
    assert all(0 < smallest < np.inf for smallest in found.values())
    units = {(name, p.name) for name, cause in CAUSES.items() for p in cause.parameters}
    assert {(cause, parameter.split(" (")[0]) for cause, parameter in found} <= units


def test_a_cause_that_a_recording_cannot_show_has_no_limit(bench: Bench, run_time: SessionPlan) -> None:
    """The frame is drawn with the headset's own optics: an error of theirs moves the dot and its drawing alike."""
    found = limits_of(measured(bench, run_time, SIGMA_PX, seed=11))
    at_run_time = {name for name, cause in CAUSES.items() if cause.part in ("eye tracking", "clock")}
    assert {cause for cause, _ in found} - {"camera_distortion", "camera_focal_length"} == at_run_time


@pytest.mark.slow
def test_an_effect_of_that_size_is_five_standard_errors_when_it_is_there(
    bench: Bench, plan: SessionPlan, noisy: Observations
) -> None:
    for name in ("panel_axial_shift", "camera_focal_length", "stage_backlash"):
        ((_, smallest),) = limits_of(noisy, {name: CAUSES[name]}).items()
        observations = measured(bench, plan, SIGMA_PX, seed=12, **{name: [smallest]})
        after = fitted(observations, explanation(**{name: [0.0]}))
        assert after is not None
        assert after.explanation.vector()[0] / after.sigmas()[0] == pytest.approx(5.0, abs=3.0)
        prior_sigma = CAUSES[name].parameters[0].prior_sigma
        with_prior = ((smallest / 5) ** -2 + prior_sigma**-2) ** -0.5
        assert after.sigmas()[0] == pytest.approx(with_prior, rel=0.15)  # what is random is found anew


def test_a_part_of_the_readings_stands_for_all(noisy: Observations) -> None:
    names = ("combiner_tilt", "target_scale", "panel_shift")
    causes = {name: CAUSES[name] for name in names}
    whole, third = limits_of(noisy, causes), limits_of(noisy, causes, 1 / 3)
    for key, smallest in whole.items():
        assert third[key] == pytest.approx(smallest, rel=0.15)


def test_a_camera_that_repeats_badly_would_hide_more(bench: Bench, plan: SessionPlan, noisy: Observations) -> None:
    """A camera that stands elsewhere in each capture hides a wrong scale of its stage."""
    shaky = with_jitter(noisy, bench, 30.0, np.random.default_rng(1))
    less, more = (limits_of(each, {"stage_scale": CAUSES["stage_scale"]}) for each in (noisy, shaky))
    assert more["stage_scale", "scale_x"] > 3.0 * less["stage_scale", "scale_x"]


def test_the_limit_of_a_slip_is_that_of_one_in_the_middle_of_the_session_and_says_so(noisy: Observations) -> None:
    """Of a slip before the session the limit would be that of a camera that stands elsewhere, five times smaller."""
    found = limits_of(noisy, {name: CAUSES[name] for name in ("headset_slip", "camera_pupil_offset")})
    slip = {name: limit for (cause, name), limit in found.items() if cause == "headset_slip"}
    assert {name.split(" (")[1] for name in slip} == {"from 1050 s on)"}
    (shift_x,) = (limit for name, limit in slip.items() if name.startswith("shift_x"))
    assert shift_x > 3.0 * found["camera_pupil_offset", "offset_x"]
