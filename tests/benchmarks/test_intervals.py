import numpy as np
import pytest
from scipy.stats import beta, binom

from benchmarks.intervals import interval_percent, mean_ratio, ratio_interval


@pytest.mark.parametrize(
    ("count", "total", "words"),
    [
        (0, 54, "below 5.4"),  # 1 - 0.05^(1 / 54)
        (54, 54, "above 94.6"),
        (0, 1, "below 95.0"),
        (1, 1, "above 5.0"),
        (1, 10, "0.3 to 44.5"),  # Clopper and Pearson 1934
        (5, 10, "18.7 to 81.3"),
        (15, 20, "50.9 to 91.3"),
    ],
)
def test_known_intervals(count, total, words):
    assert interval_percent(count, total) == words


def test_bounds_are_where_the_count_becomes_improbable():
    low, high = (float(bound) / 100 for bound in interval_percent(12, 80).split(" to "))
    assert (low, high) == pytest.approx((beta.ppf(0.025, 12, 69), beta.ppf(0.975, 13, 68)), abs=5e-4)
    assert binom.sf(11, 80, low) == pytest.approx(0.025, abs=1e-3)
    assert binom.cdf(12, 80, high) == pytest.approx(0.025, abs=1e-3)


def test_interval_of_a_ratio_holds_it_as_often_as_it_says():
    rng = np.random.default_rng(3)
    held = 0
    for _ in range(200):
        above, below = rng.exponential(2.0, 50), rng.uniform(0.5, 1.5, 50)
        low, high = ratio_interval(above, below)
        held += low < 2.0 < high
    assert 175 <= held <= 199  # bootstrap of 50 skewed sums: a little short of 190


@pytest.mark.parametrize("count", [2, 4])
def test_interval_of_the_mean_ratio_of_a_few_sessions_holds_it_as_often_as_it_says(count):
    rng = np.random.default_rng(4)
    held = 0
    for _ in range(2000):
        below = rng.uniform(0.5, 1.5, count)
        ratio, low, high = mean_ratio(0.7 * below * np.exp(rng.normal(0.0, 0.4, count)), below)
        assert low < ratio < high
        held += low < 0.7 < high
    assert 1870 <= held <= 1930  # 1900, by four standard deviations of the count at most


def test_the_mean_ratio_does_not_depend_on_which_side_is_above():
    ratio, low, high = mean_ratio([1.0, 2.0, 5.0], [2.0, 2.0, 4.0])
    inverse = mean_ratio([2.0, 2.0, 4.0], [1.0, 2.0, 5.0])
    assert (1 / ratio, 1 / high, 1 / low) == pytest.approx(inverse)
