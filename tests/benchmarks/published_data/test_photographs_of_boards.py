"""Boards on published photographs, as docs/measured-data.md shows them; skipped where the sets are not at hand."""

from collections.abc import Callable
from pathlib import Path

import pytest

from benchmarks.published_data.board_sets import SETS, PhotographSet
from wlr_render.captures.photographs import read_photograph


@pytest.mark.parametrize("which", SETS, ids=lambda which: which.title)
def test_two_photographs_of_each_set(measured_data: Callable[[str], Path], which: PhotographSet) -> None:
    paths = which.photographs(measured_data("photos"))
    for path in (paths[0], paths[-1]):
        found = which.board.find(read_photograph(path), path.name)
        assert len(found) >= 0.4 * len(which.board.indices())
        assert found.ambiguous_half_turn == which.board.half_turn_symmetric
