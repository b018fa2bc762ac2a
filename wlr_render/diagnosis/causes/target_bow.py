"""The target is not flat."""

from dataclasses import replace

from wlr_render.diagnosis.cause import Cause, Parameter
from wlr_render.numerics.arrays import FloatArray
from wlr_render.simulation.bench import Bench

DOTS = 10
"""So many dots from the middle the parameters state the sag."""


def _same_curvature(bench: Bench, sag_mm: FloatArray) -> Bench:
    return _bowed(bench, sag_mm, 0)


def _same_form(bench: Bench, sag_mm: FloatArray) -> Bench:
    return _bowed(bench, sag_mm, 1)


def _same_sag(bench: Bench, sag_mm: FloatArray) -> Bench:
    return _bowed(bench, sag_mm, 2)


def _bowed(bench: Bench, sag_mm: FloatArray, power: int) -> Bench:
    """`power`: with which inverse power of its pitch a target at another pose is bowed."""
    pitch = bench.target.pitch
    if len(pitch) == 0:
        return bench
    curvature = 1e-3 * sag_mm / (DOTS * pitch[0]) ** 2 * ((pitch[0] / pitch) ** power)[:, None]
    return replace(bench, target=replace(bench.target, bow=bench.target.bow + curvature))


CAUSE = Cause(
    "target_bow",
    "target bowed",
    "target",
    (Parameter("sag_x", "mm", 1.0), Parameter("sag_y", "mm", 1.0)),
    source="0.1 to 3 mm over mounted prints",
    separated_by="a straight edge on the target; the target turned by 90 degrees",
    variants={
        "the same curvature at every pose": _same_curvature,
        "the same form at every size": _same_form,
        "the same sag at the edge of every size": _same_sag,
    },
)
