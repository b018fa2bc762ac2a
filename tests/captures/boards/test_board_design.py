"""Every window of a board is its own, and impossible boards are refused."""

import hashlib
from typing import Any

import numpy as np
import pytest

from wlr_render.captures.boards.board_design import DISTANCE, WINDOW, check_sizes, design_board
from wlr_render.errors import BadInputError
from wlr_render.numerics.arrays import BoolArray


def turned(window: BoolArray) -> list[Any]:
    return [np.rot90(each, q) for each in (window, window.T) for q in range(4)]


@pytest.mark.parametrize(("columns", "rows"), [(5, 5), (18, 14), (40, 9)])
def test_any_two_windows_differ_in_three_sizes_however_they_are_turned_or_mirrored(columns: int, rows: int) -> None:
    large = design_board(columns, rows, 0.01).large
    windows = np.lib.stride_tricks.sliding_window_view(large, (WINDOW, WINDOW)).reshape(-1, WINDOW, WINDOW)
    seen = np.array([each.ravel() for window in windows for each in turned(window)])
    differ = np.count_nonzero(seen[:, None, :] != seen[None, :, :], axis=-1)
    assert differ[~np.eye(len(seen), dtype=bool)].min() >= DISTANCE


def test_about_half_of_the_dots_are_large_on_a_board_of_thousands() -> None:
    assert 0.45 < design_board(60, 50, 0.01).large.mean() < 0.55


def test_a_board_is_the_same_on_every_machine_and_another_for_another_seed() -> None:
    large = design_board(12, 10, 0.01).large
    printed = hashlib.sha256(np.packbits(large).tobytes()).hexdigest()
    assert printed[:16] == "404e8a05e94583c9"
    assert np.any(large != design_board(12, 10, 0.01, seed=2).large)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({"columns": 4}, "at least 5 x 5"),
        ({"columns": 150, "rows": 150}, "too large for windows of 5 x 5"),
    ],
)
def test_impossible_boards_are_refused(arguments: dict[str, Any], sentence: str) -> None:
    with pytest.raises(BadInputError, match=sentence):
        design_board(**({"columns": 8, "rows": 8, "pitch_m": 0.01} | arguments))


@pytest.mark.parametrize(
    ("large_m", "small_m", "margin_m", "sentence"),
    [
        (0.0095, 0.0038, 0.01, "nearly touch at a pitch of 10 mm"),
        (0.004, 0.0038, 0.01, "are too similar"),
        (0.006, 0.007, 0.01, "must be larger"),
        (0.006, 0.0038, 0.001, "leaves no white"),
    ],
)
def test_dots_that_cannot_be_distinguished_are_refused(
    large_m: float, small_m: float, margin_m: float, sentence: str
) -> None:
    with pytest.raises(BadInputError, match=sentence):
        check_sizes(0.01, large_m, small_m, margin_m)
