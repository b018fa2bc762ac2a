"""A thick plane element between the optics and the world, where none was assumed."""

from wlr_render.diagnosis import device_changes
from wlr_render.diagnosis.cause import Cause, Parameter, Role
from wlr_render.numerics.arrays import FloatArray
from wlr_render.simulation.bench import Bench


def _tilted(bench: Bench, values: FloatArray) -> Bench:
    return device_changes.plate_added(bench, 1e-3 * float(values[0]), tilt_deg=values[1:])


def _wedged(bench: Bench, values: FloatArray) -> Bench:
    return device_changes.plate_added(bench, 1e-3 * float(values[0]), wedge_deg=values[1:])


CAUSE = Cause(
    "see_through_plate",
    "thick plate in the see-through path",
    "device",
    (
        Parameter("thickness", "mm", 5.0, lowest=0.0),
        Parameter("angle_x", "deg", 20.0, Role.FORM),
        Parameter("angle_y", "deg", 20.0, Role.FORM),
    ),
    source="cover and prism plates of optical see-through headsets, 1 to 20 mm",
    separated_by="the target at more distances: the offset by a plate goes with 1 / distance, that by a lens does not",
    variants={"plane-parallel, tilted by the angles": _tilted, "facing the eye, a wedge of the angles": _wedged},
)
