"""The stage stands elsewhere after a move towards -x than after one towards +x."""

from dataclasses import replace

import numpy as np

from wlr_render.diagnosis.cause import Cause, Parameter
from wlr_render.numerics.arrays import FloatArray
from wlr_render.simulation.bench import Bench


def _free_towards_plus(bench: Bench, lost_mm: FloatArray) -> Bench:
    return _with(bench, [0.0, float(lost_mm[0])])


def _shared(bench: Bench, lost_mm: FloatArray) -> Bench:
    return _with(bench, [-0.5 * float(lost_mm[0]), 0.5 * float(lost_mm[0])])


def _with(bench: Bench, shift_mm: list[float]) -> Bench:
    backlash = bench.stage.backlash + 1e-3 * np.array(shift_mm)
    return replace(bench, stage=replace(bench.stage, backlash=backlash))


CAUSE = Cause(
    "stage_backlash",
    "backlash of the stage in x",
    "stage",
    (Parameter("lost_motion", "mm", 0.1),),
    source="lost motion of lead-screw stages, 0.01 to 0.3 mm",
    separated_by="the same positions approached from both sides",
    variants={"zeroed in moves towards +x": _free_towards_plus, "zeroed half-way": _shared},
)
