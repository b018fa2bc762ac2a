"""The benchmark of designs: its table, options, one session."""

import pytest

from benchmarks.design import trial as design_trial
from benchmarks.design.study import design_table
from benchmarks.design.trial import DESIGNS, DesignOutcome, DesignTrial, run_trial
from wlr_render.planning import planned_bench


def outcome(headset: str, number: int, *p95: float) -> DesignOutcome:
    return DesignOutcome(DesignTrial(headset, True, number), dict(zip(DESIGNS, p95, strict=True)))


def test_the_table_compares_designs_within_sessions() -> None:
    sessions = [outcome("northstar", 0, 1.0, 0.2, 0.1), outcome("northstar", 1, 3.0, 0.8, 0.4)]
    sessions += [outcome("birdbath28", 0, 0.4, 0.1, 0.2), outcome("birdbath28", 1, 0.4, 0.4, 0.2)]
    first, second = design_table(sessions).rows
    assert first[:5] == ["northstar", 2, pytest.approx(2.0), pytest.approx(0.5), pytest.approx(0.25)]
    assert first[7:] == [pytest.approx(0.5), "0.50 to 0.50"]
    assert second[5:8] == [pytest.approx(0.5), "0.50 to 0.50", pytest.approx(1.0)]
    low, high = map(float, str(second[8]).split(" to "))
    assert low == 0.0  # of two sessions with ratios 2 and 0.5 nothing is known
    assert high > 100.0


@pytest.mark.slow
def test_a_session_has_an_error_for_each_design_and_more_places_have_less(monkeypatch: pytest.MonkeyPatch) -> None:
    names = ("spread 9", "spread 16", "chosen 9")
    monkeypatch.setattr(planned_bench, "GRID", (9, 7))  # with less noise, so that a capture tells as much
    for name, value in (("FEW", 9), ("MANY", 16), ("PILOT_PLACES", 16)):
        monkeypatch.setattr(design_trial, name, value)
    found = run_trial(DesignTrial("birdbath28", False, 0), 1).p95
    assert tuple(found) == names
    assert 0.01 < found["spread 16"] < found["spread 9"] < 10.0
