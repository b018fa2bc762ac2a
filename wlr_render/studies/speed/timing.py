"""Times of runs that stand beside each other, and how a time grows with a size."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

ROUNDS = 15
"""Rounds that count; one more warms up."""


def alternately(*runs: Callable[[int], object], rounds: int = ROUNDS) -> list[float]:
    """Median milliseconds of each run.

    The runs take turns, so that a busy machine slows all alike; each is given the number of the round, from 0, and the
    first round is dropped.
    """
    times = np.empty((rounds + 1, len(runs)))
    for turn in range(rounds + 1):
        for number, each in enumerate(runs):
            start = time.perf_counter()
            each(turn)
            times[turn, number] = time.perf_counter() - start
    return [float(x) for x in np.median(times[1:], axis=0) * 1e3]


def in_ms(milliseconds: float) -> str:
    """As tables write it."""
    return f"{milliseconds:.1f} ms"


@dataclass(frozen=True)
class Exponent:
    """The p of time ~ size^p.

    Attributes:
        value: slope of the line through log time over log size.
        standard_error: of the slope, from the scatter about that line.
    """

    value: float
    standard_error: float

    def __str__(self) -> str:
        return f"{self.value:.2f} +- {self.standard_error:.2f}"


def exponent(sizes: Sequence[float], times: Sequence[float]) -> Exponent:
    """Least-squares slope of log time over log size.

    A cost that does not grow with the size, such as that of a call, bends the line and makes the slope too small; the
    standard error knows of scatter only.

    Raises:
        ValueError: fewer than three sizes, all the same size, or a size or time that is not positive and finite.
    """
    x, y = np.asarray(sizes, np.float64), np.asarray(times, np.float64)
    if x.shape != y.shape or x.size < 3:
        raise ValueError(f"an exponent with its error needs three sizes or more and a time for each, not {x.size}.")
    if not (np.isfinite([x, y]).all() and min(x.min(), y.min()) > 0):
        raise ValueError("sizes and times must be finite and above 0 to have logarithms.")
    x, y = np.log(x) - np.log(x).mean(), np.log(y) - np.log(y).mean()
    spread = float(x @ x)
    if spread == 0:
        raise ValueError("all sizes are the same: there is no slope.")
    slope = float(x @ y) / spread
    residual = y - slope * x
    return Exponent(slope, float(np.sqrt(residual @ residual / (x.size - 2) / spread)))
