"""The camera's entrance pupil is not where the stage believes it to be."""

from dataclasses import replace

from wlr_render.diagnosis.cause import Cause, Parameter
from wlr_render.numerics.arrays import FloatArray
from wlr_render.simulation.bench import Bench


def _offset(bench: Bench, offset_mm: FloatArray) -> Bench:
    offset = bench.camera.pupil_offset + 1e-3 * offset_mm
    return replace(bench, camera=replace(bench.camera, pupil_offset=offset))


CAUSE = Cause(
    "camera_pupil_offset",
    "camera's entrance pupil displaced",
    "camera",
    tuple(Parameter(f"offset_{axis}", "mm", 0.5) for axis in "xyz"),
    source="an entrance pupil is seldom known to better than 0.3 to 1 mm",
    separated_by="photographs of a near target without the headset from every stage position",
    variants={"at every position": _offset},
)
