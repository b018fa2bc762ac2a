"""Scaling of times with a size: a job timed at several sizes in turn, and the exponent."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from benchmarks.speed.timing import ROUNDS, Estimate, Run, alternately, exponent, in_ms
from wlr_render.report.blocks import Cell, ReportTable


@dataclass(frozen=True)
class Scaling:
    """Times of one job over sizes.

    Attributes:
        job: what was timed.
        unit: what the sizes count, e.g. "pixels".
        sizes, milliseconds: one median time each.
        growth: the exponent.
    """

    job: str
    unit: str
    sizes: tuple[float, ...]
    milliseconds: tuple[float, ...]
    growth: Estimate


def time_over(
    job: str,
    unit: str,
    sizes: Sequence[int],
    prepare: Callable[[int], Run],
    rounds: int = ROUNDS,
) -> Scaling:
    """Time a job over sizes; all sizes take turns, so that a machine that becomes busy does not bend the curve.

    Args:
        job: its name.
        unit: what the sizes count.
        sizes: three or more.
        prepare: gives a job of one size, ready to be run with the number of the round; what it does is not timed.
        rounds: that count.

    Raises:
        ValueError: as `timing.exponent`.
    """
    times = alternately(*(prepare(size) for size in sizes), rounds=rounds)
    return Scaling(job, unit, tuple(sizes), tuple(times), exponent(sizes, times))


def scaling_table(found: Sequence[Scaling]) -> ReportTable:
    """One row a job: the sizes, the times, the exponent."""
    rows: list[list[Cell]] = [
        [
            f"{each.job}, over {each.unit}",
            ", ".join(f"{size:.10g}" for size in each.sizes),
            ", ".join(in_ms(time) for time in each.milliseconds),
            str(each.growth),
        ]
        for each in found
    ]
    notes = ("The exponent p of time ~ size^p, least squares in logarithms, with its standard error from the scatter.",)
    return ReportTable("How times grow", ("what", "sizes", "times", "exponent"), rows, notes)
