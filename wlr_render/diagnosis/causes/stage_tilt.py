"""The stage's axes are turned against the headset's."""

from dataclasses import replace

import numpy as np

from wlr_render.diagnosis.cause import Cause, Parameter
from wlr_render.geometry.transforms import rotations_of_vectors
from wlr_render.numerics.arrays import FloatArray
from wlr_render.simulation.bench import Bench


def _tilted(bench: Bench, tilt_deg: FloatArray) -> Bench:
    axes = rotations_of_vectors(np.deg2rad(tilt_deg)) @ bench.stage.axes
    return replace(bench, stage=replace(bench.stage, axes=axes))


CAUSE = Cause(
    "stage_tilt",
    "the stage's axes are turned",
    "stage",
    tuple(Parameter(f"tilt_{axis}", "deg", 0.7) for axis in "xyz"),
    source="0.17 to 1.4 deg over 22 mm of travel seen on a real rig",
    separated_by="photographs of a target without the headset from every stage position",
    variants={"about the origin": _tilted},
)
