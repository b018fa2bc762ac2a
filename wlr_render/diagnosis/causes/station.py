"""Causes in the measuring station: eyeball camera, motion stage, printed target, and the mount of the headset."""

from dataclasses import replace
from functools import partial

import numpy as np

from wlr_render.bench.bench import Bench
from wlr_render.diagnosis.cause import Cause, Parameter, Perturb, Role, changed, turn
from wlr_render.numerics.arrays import FloatArray

SAG_DOTS = 10
"""The sag of a bowed target is stated at this many dots from its middle."""
_FASTEST_S = 1.0  # a fit may step below zero on its way


def _backlash(towards_minus: float, towards_plus: float) -> Perturb:
    """Return a change of the stage's positions by shares of the lost motion after moves towards -x and +x."""
    shares = np.array([towards_minus, towards_plus])
    return changed("stage", "backlash", lambda old, mm: old + 1e-3 * (mm * shares))


def _bowed(bench: Bench, sag_mm: FloatArray, *, power: int) -> Bench:
    """Bow the target; its curvature at another pose is scaled by the inverse `power` of its pitch there."""
    pitch = bench.target.pitch
    if len(pitch) == 0:
        return bench
    curvature = 1e-3 * sag_mm / (SAG_DOTS * pitch[0]) ** 2 * ((pitch[0] / pitch) ** power)[:, None]
    return replace(bench, target=replace(bench.target, bow=bench.target.bow + curvature))


def _panel_creeping(bench: Bench, values: FloatArray) -> Bench:
    mount = replace(
        bench.mount,
        panel_creep=bench.mount.panel_creep + 1e-3 * values[:2],
        warm_up_s=max(float(values[2]), _FASTEST_S),
    )
    return replace(bench, mount=mount)


def _slipped(bench: Bench, values: FloatArray) -> Bench:
    """Displace and turn the camera in the headset from some moment on."""
    mount = replace(
        bench.mount,
        slip=bench.mount.slip + 1e-3 * values[:3],
        slip_rotation=bench.mount.slip_rotation + np.deg2rad(values[3:6]),
        slip_time_s=float(values[6]),
    )
    return replace(bench, mount=mount)


CAMERA = (
    Cause(
        "camera_pupil_offset",
        "camera's entrance pupil displaced",
        "camera",
        tuple(Parameter(f"offset_{axis}", "mm", 0.5) for axis in "xyz"),
        source="an entrance pupil is seldom known to better than 0.3 to 1 mm",
        separated_by="photographs of a near target without the headset from every stage position",
        variants={"at every position": changed("camera", "pupil_offset", lambda old, mm: old + 1e-3 * mm)},
    ),
    Cause(
        "camera_rotation",
        "camera turned",
        "camera",
        tuple(Parameter(f"turn_{axis}", "deg", 0.3) for axis in "xyz"),
        source="how far a camera bracket is from square, a few tenths of a degree",
        separated_by="a photograph of the target without the headset",
        variants={
            "about its entrance pupil": changed("camera", "device_from_camera", lambda old, deg: turn(deg) @ old)
        },
    ),
    Cause(
        "camera_focal_length",
        "focal length of the camera",
        "camera",
        (Parameter("scale", "%", 0.3),),
        source="usual repeatability of camera calibrations with few views, and refocusing",
        separated_by="a photograph of the target without the headset at two distances",
        variants={"both axes alike": changed("camera", "focal_px", lambda old, percent: old * (1.0 + 1e-2 * percent))},
    ),
    Cause(
        "camera_distortion",
        "distortion of the camera lens",
        "camera",
        (Parameter("k1", "1", 0.01), Parameter("k2", "1", 0.01)),
        source="0.2 to 0.8 px at the edge of the image between lens models fitted to the same photographs",
        separated_by="photographs of a flat target without the headset that fill the image",
        variants={"radial": changed("camera", "distortion", lambda old, k: old + k)},
    ),
)
STAGE = (
    Cause(
        "stage_scale",
        "scale of the stage's axes",
        "stage",
        tuple(Parameter(f"scale_{axis}", "%", 1.0) for axis in "xyz"),
        source="lead error of micrometer screws, up to about 1 % where a wrong lead was entered",
        separated_by="a dial gauge on the stage",
        variants={
            "about the origin": changed("stage", "axes", lambda old, percent: old @ np.diag(1.0 + 1e-2 * percent))
        },
    ),
    Cause(
        "stage_tilt",
        "the stage's axes are turned",
        "stage",
        tuple(Parameter(f"tilt_{axis}", "deg", 0.7) for axis in "xyz"),
        source="0.17 to 1.4 deg over 22 mm of travel seen on a real rig",
        separated_by="photographs of a target without the headset from every stage position",
        variants={"about the origin": changed("stage", "axes", lambda old, deg: turn(deg) @ old)},
    ),
    Cause(
        "stage_backlash",
        "backlash of the stage in x",
        "stage",
        (Parameter("lost_motion", "mm", 0.1),),
        source="lost motion of lead-screw stages, 0.01 to 0.3 mm",
        separated_by="the same positions approached from both sides",
        variants={"zeroed in moves towards +x": _backlash(0.0, 1.0), "zeroed half-way": _backlash(-0.5, 0.5)},
    ),
)
TARGET = (
    Cause(
        "target_scale",
        "printed size of the target",
        "target",
        (Parameter("scale_x", "%", 0.3), Parameter("scale_y", "%", 0.3)),
        source="printers are off by about 0.4 %",
        separated_by="a ruler on the print",
        variants={"about its middle": changed("target", "scale", lambda old, percent: old * (1.0 + 1e-2 * percent))},
        remedy="enter its true size in bench.toml, or print the target anew",
    ),
    Cause(
        "target_bow",
        "target bowed",
        "target",
        (Parameter("sag_x", "mm", 1.0), Parameter("sag_y", "mm", 1.0)),
        source="0.1 to 3 mm over mounted prints",
        separated_by="a straight edge on the target; the target turned by 90 degrees",
        variants={
            "the same curvature at every pose": partial(_bowed, power=0),
            "the same form at every size": partial(_bowed, power=1),
            "the same sag at the edge of every size": partial(_bowed, power=2),
        },
    ),
)
MOUNT = (
    Cause(
        "thermal_drift",
        "panel creeps as it warms up",
        "mount",
        (
            Parameter("creep_u", "mm", 0.05),
            Parameter("creep_v", "mm", 0.05),
            Parameter("time_constant", "s", 600.0, Role.SHAPE, (900.0, 300.0, 3000.0), minimum=_FASTEST_S),
        ),
        source="plastic mounts: 0.07 mm per metre and kelvin, a few tens of micrometres over 50 mm and 20 K",
        separated_by="the first position photographed again at the end",
        variants={"exponential": _panel_creeping},
        remedy="wait three time constants before the next session; the corrected bench, and models calibrated with it, "
        "describe the cold panel, and a warm one is displaced by the whole creep",
    ),
    Cause(
        "headset_slip",
        "headset slipped",
        "mount",
        (
            *(Parameter(f"shift_{axis}", "mm", 0.5) for axis in "xyz"),
            *(Parameter(f"turn_{axis}", "deg", 0.3) for axis in "xyz"),
            Parameter("moment", "s", 1000.0, Role.TIME, (float("inf"),)),
        ),
        source="headsets on heads slip by 0.5 to 3 mm; on a mount less",
        separated_by="the first position photographed again at the end",
        variants={"once": _slipped},
        remedy="fasten the headset before the next session; the corrected bench describes this one",
    ),
)
