"""The combiner is thicker or thinner than its prescription."""

from wlr_render.diagnosis import device_changes
from wlr_render.diagnosis.cause import Cause, Parameter
from wlr_render.numerics.arrays import FloatArray
from wlr_render.simulation.bench import Bench


def _outer_along_axis(bench: Bench, thickness_mm: FloatArray) -> Bench:
    return device_changes.combiner_thickened(bench, 1e-3 * float(thickness_mm[0]), "outer", along_axis=True)


def _outer_along_normals(bench: Bench, thickness_mm: FloatArray) -> Bench:
    return device_changes.combiner_thickened(bench, 1e-3 * float(thickness_mm[0]), "outer")


def _inner_along_normals(bench: Bench, thickness_mm: FloatArray) -> Bench:
    return device_changes.combiner_thickened(bench, 1e-3 * float(thickness_mm[0]), "inner")


CAUSE = Cause(
    "substrate_thickness",
    "thickness of the combiner",
    "device",
    (Parameter("thickness", "mm", 0.1),),
    source="usual tolerance of moulded plastic optics, 0.05 to 0.1 mm",
    separated_by="a calliper",
    variants={
        "its outer face moves along its normals": _outer_along_normals,
        "its outer face moves along its axis": _outer_along_axis,
        "its inner face moves along its normals": _inner_along_normals,
    },
)
