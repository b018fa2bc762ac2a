"""The display panel is turned about its centre: rolled in its plane, or tilted out of it."""

import numpy as np

from wlr_render.diagnosis import device_changes
from wlr_render.diagnosis.cause import Cause, Parameter
from wlr_render.numerics.arrays import FloatArray
from wlr_render.simulation.bench import Bench


def _turned(bench: Bench, turn_deg: FloatArray) -> Bench:
    return device_changes.panel_moved(bench, turn=np.deg2rad(turn_deg))


CAUSE = Cause(
    "panel_rotation",
    "panel turned about its centre",
    "device",
    (Parameter("about_u", "deg", 1.0), Parameter("about_v", "deg", 1.0), Parameter("roll", "deg", 1.0)),
    source="spread (1.48 MAD) of 16 calibrated Project North Star units about their CAD: 1.3 to 2.4 deg of the normal",
    separated_by="a photograph of the bare panel against its frame",
    variants={"about its centre": _turned},
)
