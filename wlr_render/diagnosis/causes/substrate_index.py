"""The refractive index of the optics differs from the prescription."""

from wlr_render.diagnosis import device_changes
from wlr_render.diagnosis.cause import Cause, Parameter
from wlr_render.numerics.arrays import FloatArray
from wlr_render.simulation.bench import Bench


def _shifted(bench: Bench, index: FloatArray) -> Bench:
    return device_changes.index_shifted(bench, float(index[0]))


CAUSE = Cause(
    "substrate_index",
    "refractive index of the substrate",
    "device",
    (Parameter("index", "1", 0.01),),
    source="PMMA grades differ by 0.002, PMMA and polycarbonate by 0.09; a moulded part lies between",
    separated_by="the index of a witness piece; a second wavelength",
    variants={"of all media": _shifted},
)
