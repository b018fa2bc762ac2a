"""The display panel is displaced in its plane."""

import numpy as np

from wlr_render.diagnosis import device_changes
from wlr_render.diagnosis.cause import Cause, Parameter
from wlr_render.numerics.arrays import FloatArray
from wlr_render.simulation.bench import Bench


def _shifted(bench: Bench, shift_mm: FloatArray) -> Bench:
    return device_changes.panel_moved(bench, shift=1e-3 * np.append(shift_mm, 0.0))


CAUSE = Cause(
    "panel_shift",
    "panel displaced in its plane",
    "device",
    tuple(Parameter(f"shift_{axis}", "mm", 1.0) for axis in "uv"),
    source="spread (1.48 MAD) of 16 calibrated Project North Star units about their CAD: 0.7 and 2.5 mm",
    separated_by="a photograph of the bare panel against its frame; display captures farther off the base plane",
    variants={"along u and v": _shifted},
)
