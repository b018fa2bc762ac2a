"""Runs take turns; the exponent of synthetic times is the one that made them."""

import time

import numpy as np
import pytest

from benchmarks.speed.scaling import Scaling, scaling_table, time_over
from benchmarks.speed.timing import ROUNDS, Estimate, alternately, exponent, in_ms, ratio, times_ms


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


@pytest.mark.parametrize("power", [0.0, 1.0, 2.5])
def test_a_pure_power_is_found_without_error(power):
    sizes = np.array([3.0, 10.0, 40.0, 1000.0])
    found = exponent(sizes, 0.02 * sizes**power)
    assert found.value == pytest.approx(power, abs=1e-12)
    assert found.standard_error < 1e-12


def test_the_slope_and_its_standard_error_are_the_textbooks():
    """By hand: log2 sizes 0, 1, 2 and log2 times 0, 2, 1 have slope 1/2, residuals -1/2, 1, -1/2."""
    found = exponent([1, 2, 4], [1, 4, 2])
    assert found.value == pytest.approx(0.5)
    assert found.standard_error == pytest.approx(np.sqrt(1.5 / 1 / 2))


def test_errors_are_as_large_as_the_standard_error_says():
    rng = np.random.default_rng(11)
    sizes = np.geomspace(1, 100, 8)
    found = [exponent(sizes, sizes**1.3 * np.exp(rng.normal(0, 0.1, 8))) for _ in range(400)]
    pulls = np.array([(each.value - 1.3) / each.standard_error for each in found])
    # Student's t of 6 degrees of freedom has a variance of 6 / 4.
    assert abs(pulls.mean()) < 0.2
    assert 1.0 < pulls.std() < 1.5


@pytest.mark.parametrize(
    ("sizes", "times", "sentence"),
    [
        ([1, 2], [1, 2], "three sizes"),
        ([1, 2, 3], [1, 2], "a time for each"),
        ([1, 2, 3], [1, 0, 2], "above 0"),
        ([1, 2, np.nan], [1, 3, 2], "finite"),
        ([5, 5, 5], [1, 3, 2], "no slope"),
    ],
)
def test_what_has_no_exponent_is_refused(sizes, times, sentence):
    with pytest.raises(ValueError, match=sentence):
        exponent(sizes, times)


def test_sizes_take_turns_and_preparing_is_not_timed():
    prepared, ran = [], []

    def prepare(size):
        prepared.append(size)
        return lambda turn: ran.append((size, turn))

    found = time_over("nothing", "things", [10, 20, 40], prepare, rounds=2)
    assert prepared == [10, 20, 40]
    assert ran == [(size, turn) for turn in range(3) for size in (10, 20, 40)]
    assert (found.sizes, len(found.milliseconds)) == ((10, 20, 40), 3)


def test_the_table_has_sizes_times_and_exponent():
    table = scaling_table([Scaling("solve", "pixels", (1e3, 1e6), (0.5, 400.0), Estimate(0.967, 0.012))])
    assert table.text_rows() == [["solve, over pixels", "1000, 1000000", "0.5 ms, 400 ms", "0.97 +- 0.01"]]
