"""The combiner is displaced against the rest of the headset."""

from wlr_render.diagnosis import device_changes
from wlr_render.diagnosis.cause import Cause, Parameter
from wlr_render.numerics.arrays import FloatArray
from wlr_render.simulation.bench import Bench


def _shifted(bench: Bench, shift_mm: FloatArray) -> Bench:
    return device_changes.combiner_shifted(bench, 1e-3 * shift_mm)


CAUSE = Cause(
    "combiner_shift",
    "combiner displaced",
    "device",
    tuple(Parameter(f"shift_{axis}", "mm", 1.5) for axis in "xyz"),
    source="spread (1.48 MAD) of 16 calibrated Project North Star units about their CAD: 1.0, 2.0, 1.6 mm",
    separated_by="see-through captures of a near target, and display captures farther off the base plane",
    variants={"as a whole": _shifted},
)
