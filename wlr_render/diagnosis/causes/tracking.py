"""Causes in the headset's tracking camera: its pose in the device frame."""

from dataclasses import replace

import numpy as np

from wlr_render.diagnosis.cause import Cause, Parameter
from wlr_render.geometry.transforms import rigid, rotations_of_vectors
from wlr_render.numerics.arrays import FloatArray
from wlr_render.simulation.bench import Bench


def _turned_about_device_origin(bench: Bench, turn_deg: FloatArray) -> Bench:
    return _turned(bench, turn_deg, np.zeros(3))


def _turned_about_eye(bench: Bench, turn_deg: FloatArray) -> Bench:
    return _turned(bench, turn_deg, bench.optics.eye_box.centre)


def _turned(bench: Bench, turn_deg: FloatArray, pivot: FloatArray) -> Bench:
    turn = rotations_of_vectors(np.deg2rad(turn_deg))
    return _moved(bench, rigid(turn, pivot - turn @ pivot))


def _shifted(bench: Bench, shift_mm: FloatArray) -> Bench:
    return _moved(bench, rigid(np.eye(3), 1e-3 * shift_mm))


def _moved(bench: Bench, move: FloatArray) -> Bench:
    matrix = move @ bench.tracking.true_from_reported
    return replace(bench, tracking=replace(bench.tracking, true_from_reported=matrix))


CAUSES = (
    Cause(
        "tracking_rotation",
        "tracking camera turned",
        "tracking",
        tuple(Parameter(f"turn_{axis}", "deg", 0.3) for axis in "xyz"),
        source="hand-eye calibrations of headset cameras, a few tenths of a degree",
        separated_by="the target photographed at more distances by the bare eyeball camera and by tracking at once",
        variants={"about the device's origin": _turned_about_device_origin, "about the eye": _turned_about_eye},
    ),
    Cause(
        "tracking_translation",
        "tracking camera displaced",
        "tracking",
        tuple(Parameter(f"shift_{axis}", "mm", 1.0) for axis in "xyz"),
        source="hand-eye calibrations of headset cameras, 0.5 to 2 mm",
        separated_by="a nearer target: the offset goes with 1 / distance",
        variants={"as a whole": _shifted},
    ),
)
