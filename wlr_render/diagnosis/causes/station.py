"""Causes outside the headset's optics: camera, stage, target, mount, tracking camera, eye tracking and clock."""

from dataclasses import replace
from functools import partial

import numpy as np

from wlr_render.bench.bench import Bench
from wlr_render.diagnosis.cause import Cause, Parameter, Perturb, Role, changed, turn
from wlr_render.geometry.transforms import rigid
from wlr_render.numerics.arrays import FloatArray

SAG_DOTS = 10
"""Distance from the target's middle, in dots, at which the sag of a bowed target is stated."""
_FASTEST_S = 1.0  # shortest warm-up time: a step of the fit may go below zero


def _backlash(towards_minus: float, towards_plus: float) -> Perturb:
    """Return a `Perturb` of the stage's backlash: the shares of the lost motion after moves towards -x and +x."""
    shares = np.array([towards_minus, towards_plus])
    return changed("stage", "backlash", lambda old, mm: old + 1e-3 * (mm * shares))


def _bowed(bench: Bench, sag_mm: FloatArray, *, power: int) -> Bench:
    """Bow the target; the curvature at each pose scales with the inverse `power` of the pitch at that pose."""
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
    """Displace and turn the camera in the headset from a given time on."""
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


def _turned(bench: Bench, turn_deg: FloatArray, pivot: FloatArray) -> Bench:
    rotation = turn(turn_deg)
    return _moved(bench, rigid(rotation, pivot - rotation @ pivot))


def _moved(bench: Bench, move: FloatArray) -> Bench:
    matrix = move @ bench.tracking.true_from_reported
    return replace(bench, tracking=replace(bench.tracking, true_from_reported=matrix))


TRACKING_CAMERA = (
    Cause(
        "tracking_rotation",
        "tracking camera turned",
        "tracking",
        tuple(Parameter(f"turn_{axis}", "deg", 0.3) for axis in "xyz"),
        source="hand-eye calibrations of headset cameras, a few tenths of a degree",
        separated_by="the target photographed at more distances by the bare eyeball camera and by tracking at once",
        variants={
            "about the device's origin": lambda bench, deg: _turned(bench, deg, np.zeros(3)),
            "about the eye": lambda bench, deg: _turned(bench, deg, bench.optics.eye_box.centre),
        },
    ),
    Cause(
        "tracking_translation",
        "tracking camera displaced",
        "tracking",
        tuple(Parameter(f"shift_{axis}", "mm", 1.0) for axis in "xyz"),
        source="hand-eye calibrations of headset cameras, 0.5 to 2 mm",
        separated_by="a nearer target: the offset goes with 1 / distance",
        variants={"as a whole": lambda bench, mm: _moved(bench, rigid(np.eye(3), 1e-3 * mm))},
    ),
)
RUN_TIME = (
    Cause(
        "eye_position_bias",
        "eye tracking is biased",
        "eye tracking",
        tuple(Parameter(f"bias_{axis}", "mm", 0.5) for axis in "xyz"),
        source="eye tracking of headsets, 0.3 to 1 mm",
        separated_by="real dots at more distances: the error vanishes at the distance of the virtual image",
        variants={"constant": changed("eye_tracking", "bias", lambda old, mm: old + 1e-3 * mm)},
    ),
    Cause(
        "gaze_pupil_shift",
        "pupil moves with the gaze",
        "eye tracking",
        (Parameter("radius", "mm", 10.5),),
        source="the entrance pupil lies about 10.5 mm before the centre of rotation of the eye",
        separated_by="the same dots looked at directly and from the corner of the eye",
        variants={
            "about the centre of rotation": changed(
                "eye_tracking", "gaze_radius", lambda old, mm: old + 1e-3 * float(mm[0])
            )
        },
    ),
    Cause(
        "latency",
        "latency",
        "clock",
        (Parameter("latency", "ms", 10.0, minimum=0.0, in_bench=lambda bench: 1e3 * bench.clock.latency_s),),
        source="motion-to-photon latency after prediction, a few milliseconds; 3 arcmin per ms at 50 deg/s",
        separated_by="a head that turns at several speeds",
        variants={"constant": changed("clock", "latency_s", lambda old, ms: old + 1e-3 * float(ms[0]))},
    ),
    Cause(
        "rolling_scanout",
        "rows of the panel light up in turn",
        "clock",
        (Parameter("duration", "ms", 8.0, minimum=0.0, in_bench=lambda bench: 1e3 * bench.clock.scanout_s),),
        source="scan-out lasts most of a frame: 8 to 16 ms",
        separated_by="dots at the top and at the bottom of the panel while the head turns",
        variants={"first row first": changed("clock", "scanout_s", lambda old, ms: old + 1e-3 * float(ms[0]))},
    ),
)
