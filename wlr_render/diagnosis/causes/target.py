"""Causes in the printed target: its size and its flatness."""

from dataclasses import replace

from wlr_render.diagnosis.cause import Cause, Parameter
from wlr_render.numerics.arrays import FloatArray
from wlr_render.simulation.bench import Bench

SAG_DOTS = 10
"""The sag of a bowed target is stated at this many dots from its middle."""


def _scaled(bench: Bench, scale_percent: FloatArray) -> Bench:
    scale = bench.target.scale * (1.0 + 1e-2 * scale_percent)
    return replace(bench, target=replace(bench.target, scale=scale))


def _same_curvature(bench: Bench, sag_mm: FloatArray) -> Bench:
    return _bowed(bench, sag_mm, 0)


def _same_form(bench: Bench, sag_mm: FloatArray) -> Bench:
    return _bowed(bench, sag_mm, 1)


def _same_sag(bench: Bench, sag_mm: FloatArray) -> Bench:
    return _bowed(bench, sag_mm, 2)


def _bowed(bench: Bench, sag_mm: FloatArray, power: int) -> Bench:
    """The target bowed; its curvature at another pose goes with the inverse `power` of its pitch there."""
    pitch = bench.target.pitch
    if len(pitch) == 0:
        return bench
    curvature = 1e-3 * sag_mm / (SAG_DOTS * pitch[0]) ** 2 * ((pitch[0] / pitch) ** power)[:, None]
    return replace(bench, target=replace(bench.target, bow=bench.target.bow + curvature))


CAUSES = (
    Cause(
        "target_scale",
        "printed size of the target",
        "target",
        (Parameter("scale_x", "%", 0.3), Parameter("scale_y", "%", 0.3)),
        source="printers are off by about 0.4 %",
        separated_by="a ruler on the print",
        variants={"about its middle": _scaled},
        remedy="enter its true size in bench.toml, or print the target anew",
    ),
    Cause(
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
    ),
)
