"""Confidence intervals of counts of trials, of sums over sessions, and of ratios within sessions."""

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import binomtest, t

LEVEL = 0.95
INTERVAL = "95 % interval (%)"
"""Column heading of intervals."""
_RESAMPLED = 2000


def interval_percent(count: int, total: int) -> str:
    """Return the 95 % confidence interval (Clopper and Pearson) of a share in percent, e.g. "64.4 to 73.5".

    If no trial or every trial counts, it is a one-sided bound, e.g. "below 5.4" for 0 of 54.
    """
    test = binomtest(count, total, alternative={0: "less", total: "greater"}.get(count, "two-sided"))
    found = test.proportion_ci(LEVEL)
    if count == 0:
        return f"below {100 * found.high:.1f}"
    return f"above {100 * found.low:.1f}" if count == total else f"{100 * found.low:.1f} to {100 * found.high:.1f}"


def ratio_interval(numerators: ArrayLike, denominators: ArrayLike) -> tuple[float, float]:
    """Return the 95 % confidence interval of the ratio of two sums over sessions (n,), by bootstrap over sessions.

    Values may be dependent within a session: each session counts as one draw.
    """
    above, below = np.asarray(numerators, np.float64), np.asarray(denominators, np.float64)
    drawn = np.random.default_rng(1).integers(0, len(above), (_RESAMPLED, len(above)))
    low, high = np.quantile(above[drawn].sum(axis=1) / below[drawn].sum(axis=1), [0.5 - LEVEL / 2, 0.5 + LEVEL / 2])
    return float(low), float(high)


def mean_ratio(numerators: ArrayLike, denominators: ArrayLike) -> tuple[float, float, float]:
    """Return the geometric mean of the ratios of two or more sessions (n,), and its 95 % confidence interval.

    The logarithms of the ratios are assumed to be normal (Student's t), which also works for a few sessions, for which
    a bootstrap interval is too narrow.
    """
    logs = np.log(np.asarray(numerators, np.float64) / np.asarray(denominators, np.float64))
    mean, half = np.mean(logs), t.ppf(0.5 + LEVEL / 2, len(logs) - 1) * np.std(logs, ddof=1) / np.sqrt(len(logs))
    return float(np.exp(mean)), float(np.exp(mean - half)), float(np.exp(mean + half))
