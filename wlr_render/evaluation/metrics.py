"""Summaries of errors."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike


@dataclass(frozen=True)
class Summary:
    """Summary of a set of errors; NaN entries are omitted and counted.

    Attributes:
        rms, median, p95, maximum: in the unit of the errors; NaN without finite errors.
        count: number of finite errors.
        missing: number of NaN entries.
    """

    rms: float
    median: float
    p95: float
    maximum: float
    count: int
    missing: int


def summary(errors: ArrayLike) -> Summary:
    """Summarise errors of any shape."""
    flat = np.asarray(errors, dtype=np.float64).ravel()
    kept = flat[np.isfinite(flat)]
    if kept.size == 0:
        return Summary(np.nan, np.nan, np.nan, np.nan, 0, flat.size)
    rms = float(np.sqrt(np.mean(kept**2)))
    median, p95 = (float(q) for q in np.percentile(kept, [50, 95]))
    return Summary(rms, median, p95, float(kept.max()), kept.size, flat.size - kept.size)
