"""The headset's tracking camera is turned against the device frame."""

from dataclasses import replace

import numpy as np

from wlr_render.diagnosis.cause import Cause, Parameter
from wlr_render.geometry.transforms import rigid, rotations_of_vectors
from wlr_render.numerics.arrays import FloatArray
from wlr_render.simulation.bench import Bench


def _about_device_origin(bench: Bench, turn_deg: FloatArray) -> Bench:
    return _turned(bench, turn_deg, np.zeros(3))


def _about_eye(bench: Bench, turn_deg: FloatArray) -> Bench:
    return _turned(bench, turn_deg, bench.optics.eye_box.centre)


def _turned(bench: Bench, turn_deg: FloatArray, pivot: FloatArray) -> Bench:
    turn = rotations_of_vectors(np.deg2rad(turn_deg))
    matrix = rigid(turn, pivot - turn @ pivot) @ bench.tracking.true_from_reported
    return replace(bench, tracking=replace(bench.tracking, true_from_reported=matrix))


CAUSE = Cause(
    "tracking_rotation",
    "tracking camera turned",
    "tracking",
    tuple(Parameter(f"turn_{axis}", "deg", 0.3) for axis in "xyz"),
    source="hand-eye calibrations of headset cameras, a few tenths of a degree",
    separated_by="the target photographed at more distances by the bare eyeball camera and by tracking at once",
    variants={"about the device's origin": _about_device_origin, "about the eye": _about_eye},
)
