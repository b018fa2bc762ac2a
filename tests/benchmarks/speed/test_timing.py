"""Runs take turns; ratios and their standard errors are those of the rounds."""

import time

import numpy as np
import pytest

from benchmarks.speed.timing import ROUNDS, Estimate, alternately, in_ms, ratio, times_ms


def test_runs_are_timed_in_turn_and_the_first_round_is_dropped():
    calls = []
    first, second = alternately(lambda turn: calls.append(("a", turn)), lambda turn: calls.append(("b", turn)))
    assert calls[:4] == [("a", 0), ("b", 0), ("a", 1), ("b", 1)]
    assert len(calls) == 2 * (ROUNDS + 1)
    assert min(first, second) >= 0


def test_times_are_milliseconds_by_round_and_run():
    times = times_ms(lambda _: None, lambda turn: time.sleep(0.002 * turn), rounds=2)
    assert times.shape == (2, 2)
    assert (times[:, 1] >= [2, 4]).all()


@pytest.mark.parametrize(("given", "text"), [(0.01234, "0.0123 ms"), (7, "7 ms"), (1234.5, "1234 ms")])
def test_times_are_written_with_three_digits(given, text):
    assert in_ms(given) == text


def test_a_ratio_is_taken_round_by_round_and_one_interruption_does_not_count():
    second = np.array([10.0, 20.0, 30.0, 40.0, 50.0])
    found = ratio(second * [1.3, 1.3, 1.3, 1.3, 9.0], second)
    assert found == Estimate(pytest.approx(1.3), pytest.approx(0, abs=1e-12))


def test_ratios_scatter_as_their_standard_error_says():
    rng = np.random.default_rng(5)
    found = [ratio(rng.normal(1.2, 0.05, 41), np.ones(41)) for _ in range(400)]
    pulls = np.array([(each.value - 1.2) / each.standard_error for each in found])
    assert abs(pulls.mean()) < 0.2
    assert 0.9 < pulls.std() < 1.25
