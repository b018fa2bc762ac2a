"""The summary says what was measured, and whether a goal is reached."""

import pytest

from benchmarks.speed.figures import Figure, ratio_figure, summary_table
from benchmarks.speed.timing import Estimate


@pytest.mark.parametrize(("value", "goal"), [(1.5, "<= 1.6: reached"), (1.61, "<= 1.6: missed")])
def test_a_ratio_reaches_its_goal_or_misses_it(value, goal):
    figure = ratio_figure("frame", "3 ms", "2 ms (bare)", Estimate(value, 0.01), 1.6)
    assert summary_table([figure], ()).text_rows() == [["frame", "3 ms", "2 ms (bare)", f"{value:.2f} +- 0.01", goal]]


def test_what_has_no_goal_is_neither():
    without = ratio_figure("frame", "3 ms", "2 ms (bare)", Estimate(1.5, 0.01))
    unknown = Figure("frame on a GPU", "3 ms", goal="<= 2 ms on a GPU: not measured")
    assert [row[-1] for row in summary_table([without, unknown], ()).rows] == [None, "<= 2 ms on a GPU: not measured"]
