"""Which starts a cause is fitted from."""

from dataclasses import replace

import pytest
from small_session import fitted, weighed

from wlr_render.bench.simulate_session import simulate
from wlr_render.captures.session import Session
from wlr_render.diagnosis.causes import CAUSES
from wlr_render.diagnosis.fit import times_between_captures
from wlr_render.diagnosis.observations import observe
from wlr_render.diagnosis.prediction import Explanation, Hypothesis
from wlr_render.diagnosis.screening import screen


@pytest.mark.parametrize("times", [1, 2])
def test_without_a_moment_between_captures_nothing_can_have_slipped(bench, plan, times):
    """A lab may write the same time for all captures; with two times there is no moment away from either end."""

    def at_few_times(part):
        return replace(part, time_s=part.capture % times * 40.0)

    timeless = replace(plan, display=at_few_times(plan.display), see_through=at_few_times(plan.see_through))
    assert len(times_between_captures(timeless)) == 0
    observations = observe(bench, Session("timeless", timeless, simulate(bench, timeless)))
    readings, current = weighed(observations), fitted(observations, Explanation())
    assert screen(readings, current, Hypothesis(CAUSES["headset_slip"], "once")) is None
    assert screen(readings, current, Hypothesis(CAUSES["panel_shift"], "along u and v")) is not None
