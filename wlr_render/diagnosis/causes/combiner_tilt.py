"""The combiner is turned against the rest of the headset."""

from wlr_render.diagnosis import device_changes
from wlr_render.diagnosis.cause import Cause, Parameter
from wlr_render.numerics.arrays import FloatArray
from wlr_render.simulation.bench import Bench


def _about_its_middle(bench: Bench, tilt_deg: FloatArray) -> Bench:
    return device_changes.combiner_turned(bench, tilt_deg, device_changes.combiner_middle(bench))


CAUSE = Cause(
    "combiner_tilt",
    "combiner tilted",
    "device",
    tuple(Parameter(f"tilt_{axis}", "deg", 1.0) for axis in "xyz"),
    source="spread (1.48 MAD) of 16 calibrated Project North Star units about their CAD: 1.3 to 2.4 deg to the screen",
    separated_by="see-through captures of a near target: a shift of the panel leaves them alone, a tilt does not",
    variants={"about its middle": _about_its_middle},
)
