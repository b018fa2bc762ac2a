import numpy as np
import pytest
from scipy.stats import beta, binom

from benchmarks.intervals import interval_percent, ratio_interval


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
def test_known_intervals(count: int, total: int, words: str) -> None:
    assert interval_percent(count, total) == words


def test_bounds_are_where_the_count_becomes_improbable() -> None:
    low, high = (float(bound) / 100 for bound in interval_percent(12, 80).split(" to "))
    assert (low, high) == pytest.approx((beta.ppf(0.025, 12, 69), beta.ppf(0.975, 13, 68)), abs=5e-4)
    assert binom.sf(11, 80, low) == pytest.approx(0.025, abs=1e-3)
    assert binom.cdf(12, 80, high) == pytest.approx(0.025, abs=1e-3)


def test_interval_of_a_ratio_holds_it_as_often_as_it_says() -> None:
    rng = np.random.default_rng(3)
    held = 0
    for _ in range(200):
        above, below = rng.exponential(2.0, 50), rng.uniform(0.5, 1.5, 50)
        low, high = ratio_interval(above, below)
        held += low < 2.0 < high
    assert 175 <= held <= 199  # bootstrap of 50 skewed sums: a little short of 190
