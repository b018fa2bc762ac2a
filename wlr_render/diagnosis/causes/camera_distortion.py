"""Radial distortion of the camera lens that its calibration lacks."""

from dataclasses import replace

from wlr_render.diagnosis.cause import Cause, Parameter
from wlr_render.numerics.arrays import FloatArray
from wlr_render.simulation.bench import Bench


def _distorted(bench: Bench, radial: FloatArray) -> Bench:
    return replace(bench, camera=replace(bench.camera, distortion=bench.camera.distortion + radial))


CAUSE = Cause(
    "camera_distortion",
    "distortion of the camera lens",
    "camera",
    (Parameter("k1", "1", 0.01), Parameter("k2", "1", 0.01)),
    source="0.2 to 0.8 px at the edge of the image between lens models fitted to the same photographs",
    separated_by="photographs of a flat target without the headset that fill the image",
    variants={"radial": _distorted},
)
