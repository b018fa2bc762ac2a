"""Aliases of numpy array types, for annotations, and the check of numbers that callers give."""

import numpy as np
from numpy.typing import NDArray

from wlr_render.errors import BadInputError
from wlr_render.input_files import shown

FloatArray = NDArray[np.float64]
Float32Array = NDArray[np.float32]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

_SHOWN_VALUES = 4  # the most values of an array that an error shows; of more, its shape and type


def rows_by_label(labels: IntArray) -> tuple[IntArray, list[IntArray]]:
    """Return the different labels of rows (n,), ascending, and the rows of each."""
    order = np.argsort(labels, kind="stable")
    names, first = np.unique(labels[order], return_index=True)
    return names, np.split(order, first[1:])


def finite_array(value: object, shape: tuple[int, ...], what: str, wanted: str) -> FloatArray:
    """Return a copy of finite numbers as float64.

    Args:
        value: what a caller gave, of any type. Text and truth values are not numbers, although NumPy converts them.
        shape: that it must have; () for a single number.
        what: its name, for the error, e.g. "predict_s" or "the pose".
        wanted: what to give, for the error, e.g. "three finite numbers".

    Raises:
        BadInputError: it is not an array of finite numbers of this shape.
    """
    try:
        found = np.asarray(value)
    except (TypeError, ValueError, OverflowError):  # ragged lists, arrays of other libraries that are not in memory
        found = np.asarray(None)
    if found.dtype.kind not in "iuf" or found.shape != shape or not np.isfinite(found).all():
        small = found.dtype.kind in "iuf" and found.size <= _SHOWN_VALUES
        raise BadInputError(f"{what} is {shown(found.tolist() if small else value)}; give {wanted}.")
    return found.astype(np.float64)
