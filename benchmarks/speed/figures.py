"""Figures of the summary: our value, the value to compare it with, and whether the goal is reached."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.speed.timing import Estimate, FrameTimes, in_ms, ratio
from wlr_render.report.blocks import Cell, ReportTable


@dataclass(frozen=True)
class Figure:
    """One row of the summary.

    Attributes:
        quantity: the measured quantity.
        ours, compared_with: values with units; `compared_with` includes its description.
        ratio: ratio of our value to the other; empty without another value.
        goal: in words and numbers; empty without a goal.
        is_reached: True if the goal is reached; None without a goal, or if this machine cannot measure it.
    """

    quantity: str
    ours: str
    compared_with: str = ""
    ratio: str = ""
    goal: str = ""
    is_reached: bool | None = None

    def row(self) -> list[Cell]:
        """Return the row of the table."""
        verdict = {True: ": reached", False: ": missed", None: ""}[self.is_reached]
        return [self.quantity, self.ours, self.compared_with or None, self.ratio or None, self.goal + verdict or None]


@dataclass(frozen=True)
class Part:
    """One measurement: its figures of the summary, and its tables."""

    figures: Sequence[Figure] = ()
    tables: Sequence[ReportTable] = ()


Measurement = Callable[[], Part]


def ratio_figure(quantity: str, ours: str, compared_with: str, found: Estimate, at_most: float | None = None) -> Figure:
    """Return the figure of a ratio of times, with the largest allowed ratio."""
    goal, is_reached = ("", None) if at_most is None else (f"<= {at_most:g}", found.value <= at_most)
    return Figure(quantity, ours, compared_with, str(found), goal, is_reached)


def frame_ratio_figures(
    quantity: str, ours: FrameTimes, other: FrameTimes, name: str, at_most: float | None = None
) -> list[Figure]:
    """Compare two frames' times, as a program sees them and on the GPU; `name` is the other frame's name."""
    pairs = {quantity: (ours.seen, other.seen), f"{quantity}: GPU work": (ours.gpu, other.gpu)}
    return [
        ratio_figure(what, in_ms(np.median(one)), f"{in_ms(np.median(two))} ({name})", ratio(one, two), at_most)
        for what, (one, two) in pairs.items()
    ]


def summary_table(figures: Iterable[Figure], notes: Sequence[str]) -> ReportTable:
    """Return the first table of the report."""
    columns = "quantity", "ours", "compared with", "ratio", "goal"
    return ReportTable("Summary", columns, [each.row() for each in figures], notes)
