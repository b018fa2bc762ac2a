"""Causes in the eyeball camera: it does not look, stand or image as its calibration says."""

from dataclasses import replace

import numpy as np

from wlr_render.diagnosis.cause import Cause, Parameter
from wlr_render.geometry.transforms import rotations_of_vectors
from wlr_render.numerics.arrays import FloatArray
from wlr_render.simulation.bench import Bench


def _pupil_offset(bench: Bench, offset_mm: FloatArray) -> Bench:
    offset = bench.camera.pupil_offset + 1e-3 * offset_mm
    return replace(bench, camera=replace(bench.camera, pupil_offset=offset))


def _turned(bench: Bench, turn_deg: FloatArray) -> Bench:
    turned = rotations_of_vectors(np.deg2rad(turn_deg)) @ bench.camera.device_from_camera
    return replace(bench, camera=replace(bench.camera, device_from_camera=turned))


def _focal_length_scaled(bench: Bench, scale_percent: FloatArray) -> Bench:
    focal = bench.camera.focal_px * (1.0 + 1e-2 * float(scale_percent[0]))
    return replace(bench, camera=replace(bench.camera, focal_px=focal))


def _distorted(bench: Bench, radial: FloatArray) -> Bench:
    return replace(bench, camera=replace(bench.camera, distortion=bench.camera.distortion + radial))


CAUSES = (
    Cause(
        "camera_pupil_offset",
        "camera's entrance pupil displaced",
        "camera",
        tuple(Parameter(f"offset_{axis}", "mm", 0.5) for axis in "xyz"),
        source="an entrance pupil is seldom known to better than 0.3 to 1 mm",
        separated_by="photographs of a near target without the headset from every stage position",
        variants={"at every position": _pupil_offset},
    ),
    Cause(
        "camera_rotation",
        "camera turned",
        "camera",
        tuple(Parameter(f"turn_{axis}", "deg", 0.3) for axis in "xyz"),
        source="how far a camera bracket is from square, a few tenths of a degree",
        separated_by="a photograph of the target without the headset",
        variants={"about its entrance pupil": _turned},
    ),
    Cause(
        "camera_focal_length",
        "focal length of the camera",
        "camera",
        (Parameter("scale", "%", 0.3),),
        source="usual repeatability of camera calibrations with few views, and refocusing",
        separated_by="a photograph of the target without the headset at two distances",
        variants={"both axes alike": _focal_length_scaled},
    ),
    Cause(
        "camera_distortion",
        "distortion of the camera lens",
        "camera",
        (Parameter("k1", "1", 0.01), Parameter("k2", "1", 0.01)),
        source="0.2 to 0.8 px at the edge of the image between lens models fitted to the same photographs",
        separated_by="photographs of a flat target without the headset that fill the image",
        variants={"radial": _distorted},
    ),
)
