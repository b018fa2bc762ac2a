"""The headset's tracking camera is displaced in the device frame."""

from dataclasses import replace

import numpy as np

from wlr_render.diagnosis.cause import Cause, Parameter
from wlr_render.geometry.transforms import rigid
from wlr_render.numerics.arrays import FloatArray
from wlr_render.simulation.bench import Bench


def _shifted(bench: Bench, shift_mm: FloatArray) -> Bench:
    matrix = rigid(np.eye(3), 1e-3 * shift_mm) @ bench.tracking.true_from_reported
    return replace(bench, tracking=replace(bench.tracking, true_from_reported=matrix))


CAUSE = Cause(
    "tracking_translation",
    "tracking camera displaced",
    "tracking",
    tuple(Parameter(f"shift_{axis}", "mm", 1.0) for axis in "xyz"),
    source="hand-eye calibrations of headset cameras, 0.5 to 2 mm",
    separated_by="a nearer target: the offset goes with 1 / distance",
    variants={"as a whole": _shifted},
)
