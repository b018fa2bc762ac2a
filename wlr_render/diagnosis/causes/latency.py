"""Frames are seen later than the time for which they are drawn."""

from dataclasses import replace

from wlr_render.diagnosis.cause import Cause, Parameter
from wlr_render.numerics.arrays import FloatArray
from wlr_render.simulation.bench import Bench


def _changed(bench: Bench, values: FloatArray) -> Bench:
    return replace(bench, clock=replace(bench.clock, latency_s=bench.clock.latency_s + 1e-3 * float(values[0])))


CAUSE = Cause(
    "latency",
    "latency",
    "clock",
    (Parameter("latency", "ms", 10.0),),
    source="motion-to-photon latency after prediction, a few milliseconds; 3 arcmin per ms at 50 deg/s",
    separated_by="a head that turns at several speeds",
    variants={"constant": _changed},
)
