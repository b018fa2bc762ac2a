"""The lit area is larger or smaller than stated, as with heat or a wrong pitch in the data sheet."""

from wlr_render.diagnosis import device_changes
from wlr_render.diagnosis.cause import Cause, Parameter
from wlr_render.numerics.arrays import FloatArray
from wlr_render.simulation.bench import Bench


def _scaled(bench: Bench, scale_percent: FloatArray) -> Bench:
    return device_changes.panel_scaled(bench, 1.0 + 1e-2 * float(scale_percent[0]))


CAUSE = Cause(
    "panel_scale",
    "panel larger than stated",
    "device",
    (Parameter("scale", "%", 0.3),),
    source="rounding of a pixel pitch in a data sheet, a few parts in a thousand; heat is ten times less",
    separated_by="a photograph of the bare panel with a ruler",
    variants={"about its centre": _scaled},
)
