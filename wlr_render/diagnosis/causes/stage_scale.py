"""The stage moves by more or less than its micrometers say."""

from dataclasses import replace

import numpy as np

from wlr_render.diagnosis.cause import Cause, Parameter
from wlr_render.numerics.arrays import FloatArray
from wlr_render.simulation.bench import Bench


def _scaled(bench: Bench, scale_percent: FloatArray) -> Bench:
    axes = bench.stage.axes @ np.diag(1.0 + 1e-2 * scale_percent)
    return replace(bench, stage=replace(bench.stage, axes=axes))


CAUSE = Cause(
    "stage_scale",
    "scale of the stage's axes",
    "stage",
    tuple(Parameter(f"scale_{axis}", "%", 1.0) for axis in "xyz"),
    source="lead error of micrometer screws, up to about 1 % where a wrong lead was entered",
    separated_by="a dial gauge on the stage",
    variants={"about the origin": _scaled},
)
