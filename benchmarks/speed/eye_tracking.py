"""Cost of a map that follows the eye: a new ray map in every frame."""

from benchmarks.speed.figures import Part, frame_ratio_figures
from benchmarks.speed.running import Running
from benchmarks.speed.timing import frame_times
from benchmarks.speed.workload import Workload

PRICE_GOAL = 1.02


def price(work: Workload, context: str) -> Part:
    """Compare a frame with a ray map for a new viewpoint with the same frame with the existing map."""
    with Running.of(work, context) as on:
        # The first frame of a round solves its ray map, the second reuses it.
        tracked, kept = frame_times(*[on.of_round(on.frame)] * 2, rounds=work.rounds)
    name = "price of eye tracking: frame of both eyes with new ray maps"
    return Part(frame_ratio_figures(name, tracked, kept, "same frame, ray maps kept", PRICE_GOAL))
