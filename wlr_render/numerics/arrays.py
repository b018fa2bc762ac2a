"""Aliases of numpy array types, for annotations, and the check of callers' numbers."""

import numpy as np
from numpy.typing import NDArray

from wlr_render.errors import BadInputError
from wlr_render.io.input_files import shown

FloatArray = NDArray[np.float64]
Float32Array = NDArray[np.float32]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

_SHOWN_VALUES = 4  # most values that an error prints; longer arrays are described by shape and type


def read_only(array: FloatArray) -> FloatArray:
    """Make an array read-only, because it is computed once and shared, and return it."""
    array.flags.writeable = False
    return array


def rows_by_label(labels: IntArray) -> tuple[IntArray, list[IntArray]]:
    """Return the distinct labels of rows (n,), ascending, and the rows that have each label."""
    order = np.argsort(labels, kind="stable")
    names, first = np.unique(labels[order], return_index=True)
    return names, np.split(order, first[1:])


def finite_array(value: object, shape: tuple[int, ...], what: str, wanted: str) -> FloatArray:
    """Return a float64 copy of an array of finite numbers.

    Args:
        value: the caller's argument, of any type. Text and booleans are not numbers, although NumPy converts them.
        shape: required shape; () for a single number.
        what: name of the argument, for the error, e.g. "predict_s" or "the pose".
        wanted: valid values, for the error, e.g. "three finite numbers".

    Raises:
        BadInputError: it is not an array of finite numbers of this shape.
    """
    try:
        numbers = np.asarray(value)
    except (TypeError, ValueError, OverflowError):  # ragged lists, or arrays of other libraries outside main memory
        numbers = np.asarray(None)
    if numbers.dtype.kind not in "iuf" or numbers.shape != shape or not np.isfinite(numbers).all():
        small = numbers.dtype.kind in "iuf" and numbers.size <= _SHOWN_VALUES
        raise BadInputError(f"{what} is {shown(numbers.tolist() if small else value)}; give {wanted}.")
    return numbers.astype(np.float64)
