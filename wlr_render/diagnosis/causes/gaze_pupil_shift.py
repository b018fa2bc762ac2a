"""The pupil moves with the gaze, and tracking does not follow."""

from dataclasses import replace

from wlr_render.diagnosis.cause import Cause, Parameter
from wlr_render.numerics.arrays import FloatArray
from wlr_render.simulation.bench import Bench


def _changed(bench: Bench, values: FloatArray) -> Bench:
    radius = bench.eye_tracking.gaze_radius + 1e-3 * float(values[0])
    return replace(bench, eye_tracking=replace(bench.eye_tracking, gaze_radius=radius))


CAUSE = Cause(
    "gaze_pupil_shift",
    "pupil moves with the gaze",
    "eye tracking",
    (Parameter("radius", "mm", 10.5),),
    source="the entrance pupil lies about 10.5 mm before the centre of rotation of the eye",
    separated_by="the same dots looked at directly and from the corner of the eye",
    variants={"about the centre of rotation": _changed},
)
