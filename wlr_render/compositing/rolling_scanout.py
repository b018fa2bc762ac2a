"""Head poses of the rows of a display that lights up row by row."""

from typing import Literal

import numpy as np

from wlr_render.geometry import transforms
from wlr_render.numerics.arrays import FloatArray

Scan = Literal["down", "up"]
"""Order in which the rows of a display light up: the top one first, or the bottom one."""


def row_poses(first: FloatArray, last: FloatArray, rows: int, scan: Scan = "down") -> FloatArray:
    """Interpolate the head pose of each row, (rows, 4, 4) from the top, between two (4, 4).

    `first` is the pose when the first row lights up, the bottom one with "up". Rows light up at equal intervals, and
    the head moves at constant speed meanwhile.
    """
    poses = transforms.between(first, last, np.linspace(0.0, 1.0, rows))
    return poses if scan == "down" else poses[::-1]
