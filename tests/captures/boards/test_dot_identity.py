"""Any fragment that is large enough is told, at any rotation; no smaller one is ever told wrongly."""

import numpy as np
import pytest
from captures.boards.board_pictures import BOARD
from present import present

from wlr_render.captures.boards.board import BoardNotFoundError
from wlr_render.captures.boards.board_design import WINDOW, design_board
from wlr_render.captures.boards.dot_board import identify
from wlr_render.numerics.arrays import BoolArray, IntArray

TURNS = [np.linalg.matrix_power(np.array([[0, 1], [-1, 0]]), q) for q in range(4)]


def window(column: int | np.int64, row: int | np.int64, width: int, height: int) -> IntArray:
    u, v = np.meshgrid(np.arange(column, column + width), np.arange(row, row + height))
    return np.stack([u, v], axis=-1).reshape(-1, 2)


def sizes_at(index: IntArray) -> BoolArray:
    return BOARD.large[index[:, 1], index[:, 0]]


def answer(true: IntArray, turn: IntArray, is_large: BoolArray, shift: tuple[int, int] = (7, -11)) -> IntArray | None:
    """What is said of dots that are seen turned and shifted; None where nothing is."""
    try:
        return identify(true @ turn + np.array(shift), is_large, BOARD.large)
    except BoardNotFoundError:
        return None


@pytest.mark.slow
def test_every_window_is_told_at_every_rotation() -> None:
    for row in range(BOARD.rows - WINDOW + 1):
        for column in range(BOARD.columns - WINDOW + 1):
            true = window(column, row, WINDOW, WINDOW)
            turn = TURNS[(row + column) % 4] if 0 < row < BOARD.rows - WINDOW else None
            for each in TURNS if turn is None else [turn]:
                assert np.array_equal(present(answer(true, each, sizes_at(true))), true)


def test_smaller_fragments_are_told_rightly_or_not_at_all() -> None:
    rng = np.random.default_rng(1)
    told = 0
    for _ in range(150):
        width, height = rng.integers(2, 6, 2)
        true = window(rng.integers(0, BOARD.columns - width), rng.integers(0, BOARD.rows - height), width, height)
        found = answer(true, TURNS[rng.integers(4)], sizes_at(true))
        told += found is not None
        assert found is None or np.array_equal(found, true)
    assert told < 150, "not one of them was refused"


def test_one_misread_size_in_the_smallest_window_never_misleads() -> None:
    rng = np.random.default_rng(2)
    for _ in range(100):
        true = window(rng.integers(0, 13), rng.integers(0, 9), WINDOW, WINDOW)
        wrong = np.arange(len(true)) == rng.integers(len(true))
        found = answer(true, TURNS[rng.integers(4)], sizes_at(true) ^ wrong)
        assert found is None or np.array_equal(found, true)


def test_a_larger_fragment_with_holes_bears_several_misread_sizes() -> None:
    rng = np.random.default_rng(3)
    for _ in range(30):
        true = window(rng.integers(0, 9), rng.integers(0, 5), 9, 9)
        true = true[rng.permutation(81)[:60]]
        wrong = np.arange(60) < 6
        assert np.array_equal(present(answer(true, TURNS[rng.integers(4)], sizes_at(true) ^ wrong)), true)


def test_a_whole_board_of_thousands_is_told() -> None:
    large = design_board(50, 40, 0.01).large
    true = window(0, 0, 50, 40)
    is_large = large.ravel() ^ (np.arange(2000) % 20 == 0)
    assert np.array_equal(identify(true @ TURNS[3] + np.array([5, 5]), is_large, large), true)


def test_dots_beyond_the_board_are_placed_beyond_it() -> None:
    true = window(-2, 3, 12, 8)
    on_board = true[:, 0] >= 0
    is_large = np.where(on_board, sizes_at(np.maximum(true, 0)), True)
    assert np.array_equal(present(answer(true, TURNS[1], is_large)), true)


def test_too_few_dots_say_how_many_are_needed() -> None:
    true = window(2, 2, 4, 3)
    with pytest.raises(BoardNotFoundError, match=r"only 12 dots .* at least 20 are needed"):
        identify(true, sizes_at(true), BOARD.large)


def test_another_board_is_not_taken_for_this_one() -> None:
    rng = np.random.default_rng(4)
    true = window(0, 0, 10, 10)
    for _ in range(30):
        with pytest.raises(BoardNotFoundError, match="is it another board"):
            identify(true, rng.random(100) < 0.5, BOARD.large)


def test_a_repeating_board_is_ambiguous() -> None:
    true = window(0, 0, 6, 6)
    chequers = np.indices((14, 18)).sum(axis=0) % 2 == 1
    with pytest.raises(BoardNotFoundError, match="fit the board in more than one place"):
        identify(true, chequers[true[:, 1], true[:, 0]], chequers)


def test_the_mirror_image_of_every_window_is_called_so() -> None:
    for row in range(0, BOARD.rows - WINDOW + 1, 3):
        for column in range(0, BOARD.columns - WINDOW + 1, 3):
            true = window(column, row, WINDOW, WINDOW)
            with pytest.raises(BoardNotFoundError, match="mirrored"):
                identify(true * np.array([-1, 1]), sizes_at(true), BOARD.large)
