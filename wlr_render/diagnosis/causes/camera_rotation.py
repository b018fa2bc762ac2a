"""The camera is turned against the axes of the device."""

from dataclasses import replace

import numpy as np

from wlr_render.diagnosis.cause import Cause, Parameter
from wlr_render.geometry.transforms import rotations_of_vectors
from wlr_render.numerics.arrays import FloatArray
from wlr_render.simulation.bench import Bench


def _turned(bench: Bench, turn_deg: FloatArray) -> Bench:
    turned = rotations_of_vectors(np.deg2rad(turn_deg)) @ bench.camera.device_from_camera
    return replace(bench, camera=replace(bench.camera, device_from_camera=turned))


CAUSE = Cause(
    "camera_rotation",
    "camera turned",
    "camera",
    tuple(Parameter(f"turn_{axis}", "deg", 0.3) for axis in "xyz"),
    source="how far a camera bracket is from square, a few tenths of a degree",
    separated_by="a photograph of the target without the headset",
    variants={"about its entrance pupil": _turned},
)
