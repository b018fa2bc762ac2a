"""The camera's focal length is not what its calibration says."""

from dataclasses import replace

from wlr_render.diagnosis.cause import Cause, Parameter
from wlr_render.numerics.arrays import FloatArray
from wlr_render.simulation.bench import Bench


def _scaled(bench: Bench, scale_percent: FloatArray) -> Bench:
    focal = bench.camera.focal_px * (1.0 + 1e-2 * float(scale_percent[0]))
    return replace(bench, camera=replace(bench.camera, focal_px=focal))


CAUSE = Cause(
    "camera_focal_length",
    "focal length of the camera",
    "camera",
    (Parameter("scale", "%", 0.3),),
    source="usual repeatability of camera calibrations with few views, and refocusing",
    separated_by="a photograph of the target without the headset at two distances",
    variants={"both axes alike": _scaled},
)
