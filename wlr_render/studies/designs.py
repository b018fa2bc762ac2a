"""Where each kind of model wants its captures taken."""

import numpy as np
from numpy.typing import NDArray

from wlr_render.simulation import viewpoints
from wlr_render.simulation.bench import Bench


def camera_positions(bench: Bench, kind: str, count: int) -> NDArray[np.float64]:
    """(count, 3) in the eye box for "volumetric", else in the base plane; "static" takes one, at the centre."""
    box = bench.truth.eye_box
    if kind == "static":
        return viewpoints.nominal(box)
    if kind == "volumetric":
        return viewpoints.volumetric(box, count)
    return viewpoints.planar(box, bench.field.reach, count)
