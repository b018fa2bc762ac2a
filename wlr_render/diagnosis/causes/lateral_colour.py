"""Red and blue are magnified differently from green."""

from dataclasses import replace

import numpy as np

from wlr_render.diagnosis.cause import Cause, Parameter
from wlr_render.numerics.arrays import FloatArray
from wlr_render.simulation.bench import Bench


def _magnified(bench: Bench, scale_percent: FloatArray) -> Bench:
    red, blue = 1e-2 * scale_percent
    scale = bench.readout.channel_scale * (1.0 + np.array([red, 0.0, blue]))
    return replace(bench, readout=replace(bench.readout, channel_scale=scale))


CAUSE = Cause(
    "lateral_colour",
    "lateral colour",
    "device",
    (Parameter("red", "%", 0.3), Parameter("blue", "%", 0.3)),
    source="2.4 arcmin at 14 deg in a see-through headset, 20 arcmin at 44 deg in a lens of virtual reality",
    separated_by="captures in all three colours from the same positions",
    variants={"about the panel's centre": _magnified},
)
