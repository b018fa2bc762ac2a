"""A thick plane element between the optics and the world, where none was assumed."""

from wlr_render.diagnosis import device_changes
from wlr_render.diagnosis.cause import Cause, FloatArray, Parameter, Role
from wlr_render.simulation.bench import Bench


def _added(bench: Bench, values: FloatArray) -> Bench:
    return device_changes.plate_added(bench, 1e-3 * float(values[0]), values[1:])


CAUSE = Cause(
    "see_through_plate",
    "thick plate in the see-through path",
    "device",
    (
        Parameter("thickness", "mm", 5.0, lowest=0.0),
        Parameter("tilt_x", "deg", 20.0, Role.FORM),
        Parameter("tilt_y", "deg", 20.0, Role.FORM),
    ),
    source="cover and prism plates of optical see-through headsets, 1 to 20 mm",
    separated_by="the target at more distances: the offset by a plate goes with 1 / distance, that by a lens does not",
    variants={"of PMMA": _added},
)
