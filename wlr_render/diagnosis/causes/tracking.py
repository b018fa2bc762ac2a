"""Causes in tracking and timing: pose of the tracking camera, eye tracking, and the clock."""

from dataclasses import replace

import numpy as np

from wlr_render.bench.bench import Bench
from wlr_render.diagnosis.cause import Cause, Parameter, changed, turn
from wlr_render.geometry.transforms import rigid
from wlr_render.numerics.arrays import FloatArray


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
