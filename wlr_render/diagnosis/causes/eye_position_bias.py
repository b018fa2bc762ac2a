"""The pupil is not where eye tracking says it is."""

from dataclasses import replace

from wlr_render.diagnosis.cause import Cause, Parameter
from wlr_render.numerics.arrays import FloatArray
from wlr_render.simulation.bench import Bench


def _changed(bench: Bench, values: FloatArray) -> Bench:
    tracking = replace(bench.eye_tracking, bias=bench.eye_tracking.bias + 1e-3 * values)
    return replace(bench, eye_tracking=tracking)


CAUSE = Cause(
    "eye_position_bias",
    "eye tracking is biased",
    "eye tracking",
    tuple(Parameter(f"bias_{axis}", "mm", 0.5) for axis in "xyz"),
    source="eye tracking of headsets, 0.3 to 1 mm",
    separated_by="real dots at more distances: the error vanishes at the distance of the virtual image",
    variants={"constant": _changed},
)
