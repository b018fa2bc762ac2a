"""Values of optional and united types, narrowed where a test knows more."""

from typing import TypeVar

import numpy as np

Value = TypeVar("Value")


def present(value: Value | None) -> Value:
    """Return a value that is not None."""
    assert value is not None
    return value


def narrowed(value: object, kind: type[Value]) -> Value:
    """Return a value that is of a class."""
    assert isinstance(value, kind)
    return value


def as_number(cell: object) -> float:
    """Return a cell of a table that is a number."""
    assert isinstance(cell, int | float | np.integer | np.floating)
    return float(cell)
