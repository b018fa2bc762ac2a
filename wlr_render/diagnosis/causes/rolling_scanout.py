"""The rows of the panel light up one after the other."""

from dataclasses import replace

from wlr_render.diagnosis.cause import Cause, Parameter
from wlr_render.numerics.arrays import FloatArray
from wlr_render.simulation.bench import Bench


def _changed(bench: Bench, values: FloatArray) -> Bench:
    return replace(bench, clock=replace(bench.clock, scanout_s=bench.clock.scanout_s + 1e-3 * float(values[0])))


CAUSE = Cause(
    "rolling_scanout",
    "rows of the panel light up in turn",
    "clock",
    (Parameter("duration", "ms", 8.0),),
    source="scan-out lasts most of a frame: 8 to 16 ms",
    separated_by="dots at the top and at the bottom of the panel while the head turns",
    variants={"first row first": _changed},
)
