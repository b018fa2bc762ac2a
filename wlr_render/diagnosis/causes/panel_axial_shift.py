"""The display panel is displaced along its normal: defocus and a change of magnification."""

import numpy as np

from wlr_render.diagnosis import device_changes
from wlr_render.diagnosis.cause import Cause, Parameter
from wlr_render.numerics.arrays import FloatArray
from wlr_render.simulation.bench import Bench


def _shifted(bench: Bench, shift_mm: FloatArray) -> Bench:
    return device_changes.panel_moved(bench, shift=1e-3 * np.array([0.0, 0.0, shift_mm[0]]))


CAUSE = Cause(
    "panel_axial_shift",
    "panel displaced along its normal",
    "device",
    (Parameter("shift", "mm", 0.5),),
    source="spread (1.48 MAD) of 16 calibrated Project North Star units about their CAD: 0.5 mm",
    separated_by="display captures over a deeper eye box: a magnified panel swims differently from a displaced one",
    variants={"along the normal": _shifted},
)
