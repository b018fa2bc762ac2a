"""The headset slips on its mount at some moment, so that the camera stands elsewhere in it from then on."""

from dataclasses import replace

import numpy as np

from wlr_render.diagnosis.cause import Cause, Parameter, Role
from wlr_render.numerics.arrays import FloatArray
from wlr_render.simulation.bench import Bench


def _slipped(bench: Bench, values: FloatArray) -> Bench:
    mount = replace(
        bench.mount,
        slip=bench.mount.slip + 1e-3 * values[:3],
        slip_rotation=bench.mount.slip_rotation + np.deg2rad(values[3:6]),
        slip_time_s=float(values[6]),
    )
    return replace(bench, mount=mount)


CAUSE = Cause(
    "headset_slip",
    "headset slipped",
    "mount",
    (
        *(Parameter(f"shift_{axis}", "mm", 0.5) for axis in "xyz"),
        *(Parameter(f"turn_{axis}", "deg", 0.3) for axis in "xyz"),
        Parameter("moment", "s", 1000.0, Role.MOMENT, (float("inf"),)),
    ),
    source="headsets on heads slip by 0.5 to 3 mm; on a mount less",
    separated_by="the first position photographed again at the end",
    variants={"once": _slipped},
    remedy="fasten the headset before the next session; the extended bench corrects this one",
)
