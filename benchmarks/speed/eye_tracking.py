"""What it costs that the map follows the eye: a new ray map in every frame."""

from collections.abc import Callable

import numpy as np

from benchmarks.speed.figures import Figure, Part, ratio_figure
from benchmarks.speed.running import Running
from benchmarks.speed.timing import in_ms, ratio, times_ms
from benchmarks.speed.workload import Workload

PRICE_GOAL = 1.02


def price(work: Workload, context: str) -> Part:
    """Compare a frame with a ray map for a new viewpoint with the same frame with the existing map."""
    with Running.of(work, context) as on:
        return Part([price_figure(on.frame, work.rounds)])


def price_figure(frame: Callable[[int], object], rounds: int) -> Figure:
    """Return the figure of a frame that solves its ray map only when it is called with another round."""
    times = times_ms(frame, frame, rounds=rounds)
    tracked, kept = np.median(times, axis=0)
    return ratio_figure(
        "price of eye tracking: frame of both eyes with new ray maps",
        in_ms(tracked),
        f"{in_ms(kept)} (same frame, ray maps kept)",
        ratio(times[:, 0], times[:, 1]),
        PRICE_GOAL,
    )
