"""Runs take turns; ratios and their standard errors are those of the rounds."""

import numpy as np
import pytest

from benchmarks.speed.timing import ROUNDS, alternately, ratio


def test_runs_are_timed_in_turn_and_the_first_round_is_dropped() -> None:
    calls = []
    first, second = alternately(lambda turn: calls.append(("a", turn)), lambda turn: calls.append(("b", turn)))
    assert calls[:4] == [("a", 0), ("b", 0), ("a", 1), ("b", 1)]
    assert len(calls) == 2 * (ROUNDS + 1)
    assert min(first, second) >= 0


def test_a_ratio_is_taken_round_by_round_and_one_interruption_does_not_count() -> None:
    second = np.array([10.0, 20.0, 30.0, 40.0, 50.0])
    found = ratio(second * [1.3, 1.3, 1.3, 1.3, 9.0], second)
    assert found.value == pytest.approx(1.3)
    assert found.standard_error == pytest.approx(0, abs=1e-12)
