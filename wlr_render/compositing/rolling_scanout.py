"""Head poses of the rows of a display that lights up row by row."""

import numpy as np

from wlr_render.geometry import transforms
from wlr_render.numerics.arrays import FloatArray


def row_poses(first: FloatArray, last: FloatArray, rows: int) -> FloatArray:
    """Interpolate the head pose of each row, (rows, 4, 4), between the first and the last row's (4, 4).

    Rows light up at equal intervals, and the head moves at constant speed meanwhile.
    """
    return transforms.between(first, last, np.linspace(0.0, 1.0, rows))
