"""Times of alternating runs, and their ratios."""

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from wlr_render.numerics.arrays import FloatArray
from wlr_render.report.blocks import cell_text

ROUNDS = 15
"""Rounds that count; one more warms up."""
GPU_ROUNDS = 150
"""The same where a frame takes a millisecond."""

Run = Callable[[int], object]
"""Something to time; it is given the number of the round, from 0."""

# Standard deviations of a normal distribution from its median absolute deviation, and of a median from its samples'.
_SIGMA_OF_MAD, _OF_MEDIAN = 1.4826, 1.2533


def times_ms(*runs: Run, rounds: int = ROUNDS) -> FloatArray:
    """Time runs in milliseconds, (rounds, runs).

    The runs alternate, so that a busy machine slows all equally; the first round is dropped.
    """
    times = np.empty((rounds + 1, len(runs)))
    for turn in range(rounds + 1):
        for number, each in enumerate(runs):
            start = time.perf_counter()
            each(turn)
            times[turn, number] = time.perf_counter() - start
    return times[1:] * 1e3


def alternately(*runs: Run, rounds: int = ROUNDS) -> list[float]:
    """Median milliseconds of each run, as `times_ms`."""
    return [float(x) for x in np.median(times_ms(*runs, rounds=rounds), axis=0)]


def in_ms(milliseconds: float) -> str:
    """Format milliseconds for tables."""
    return f"{cell_text(float(milliseconds))} ms"


@dataclass(frozen=True)
class Estimate:
    """A figure taken from times.

    Attributes:
        value: the figure.
        standard_error: its standard error, from the scatter of the times.
    """

    value: float
    standard_error: float

    def __str__(self) -> str:
        return f"{self.value:.2f} +- {self.standard_error:.2f}"


def ratio(first_ms: FloatArray, second_ms: FloatArray) -> Estimate:
    """Return how many times longer the first takes, from times (rounds,) of both: the median of the rounds' ratios.

    The standard error assumes normally distributed ratios and takes their spread from the median absolute deviation, so
    that a single interrupted round does not count.
    """
    ratios = np.asarray(first_ms, np.float64) / second_ms
    middle = float(np.median(ratios))
    spread = _SIGMA_OF_MAD * float(np.median(np.abs(ratios - middle)))
    return Estimate(middle, _OF_MEDIAN * spread / float(np.sqrt(ratios.size)))
