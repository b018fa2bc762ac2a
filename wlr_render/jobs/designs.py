"""Where each kind of model wants its captures taken."""

import numpy as np
from numpy.typing import NDArray

from wlr_render.simulation import viewpoints
from wlr_render.simulation.simulate_captures import CaptureSetup


def camera_positions(setup: CaptureSetup, kind: str, count: int) -> NDArray[np.float64]:
    """(count, 3) in the eye box for "volumetric", else in the base plane; "static" takes one, at the centre."""
    box = setup.truth.eye_box
    if kind == "static":
        return viewpoints.nominal(box)
    if kind == "volumetric":
        return viewpoints.volumetric(box, count)
    return viewpoints.planar(box, setup.field.reach, count)
