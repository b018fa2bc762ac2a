from pathlib import Path

import pytest
from memo import memoised


def test_a_function_is_called_once_for_each_argument_whoever_asks(tmp_path: Path) -> None:
    calls = []

    def doubled(number: float) -> float:
        calls.append(number)
        return 2 * number

    one, other = (memoised(doubled, tmp_path) for _ in range(2))
    assert [one(1), other(1), other(2)] == [2, 2, 4]
    assert calls == [1, 2]


def test_an_error_is_raised_for_everybody_who_asks(tmp_path: Path) -> None:
    divided = memoised(lambda number: 1 / number, tmp_path)
    for _ in range(2):
        with pytest.raises(ZeroDivisionError):
            divided(0)


def test_an_interrupted_computation_is_begun_again(tmp_path: Path) -> None:
    """As by a time limit of a test: who asks next does not wait for a result that nobody computes."""
    interrupts = [KeyboardInterrupt]

    def computed() -> int:
        if interrupts:
            raise interrupts.pop()
        return 5

    with pytest.raises(KeyboardInterrupt):
        memoised(computed, tmp_path)()
    assert memoised(computed, tmp_path)() == 5
