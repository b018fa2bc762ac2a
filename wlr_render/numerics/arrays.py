"""Aliases of numpy array types, for annotations."""

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Float32Array = NDArray[np.float32]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


def rows_by_label(labels: IntArray) -> tuple[IntArray, list[IntArray]]:
    """The different labels of rows (n,), ascending, and the rows of each."""
    order = np.argsort(labels, kind="stable")
    names, first = np.unique(labels[order], return_index=True)
    return names, np.split(order, first[1:])
