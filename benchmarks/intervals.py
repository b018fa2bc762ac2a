"""Confidence intervals of counts of trials."""

from scipy.stats import binomtest

LEVEL = 0.95
INTERVAL = "95 % interval (%)"
"""Head of a column of intervals."""


def interval_percent(count: int, total: int) -> str:
    """95 % confidence interval (Clopper and Pearson) of a share in percent, e.g. "64.4 to 73.5".

    Where no trial or every trial counts, it is the one-sided bound, e.g. "below 5.4" for 0 of 54.
    """
    test = binomtest(count, total, alternative={0: "less", total: "greater"}.get(count, "two-sided"))
    found = test.proportion_ci(LEVEL)
    if count == 0:
        return f"below {100 * found.high:.1f}"
    return f"above {100 * found.low:.1f}" if count == total else f"{100 * found.low:.1f} to {100 * found.high:.1f}"
