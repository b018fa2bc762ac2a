"""Causes that show while the glasses run: eye tracking and the clock."""

from dataclasses import replace

from wlr_render.diagnosis.cause import Cause, Parameter
from wlr_render.numerics.arrays import FloatArray
from wlr_render.simulation.bench import Bench


def _eye_position_biased(bench: Bench, bias_mm: FloatArray) -> Bench:
    tracking = replace(bench.eye_tracking, bias=bench.eye_tracking.bias + 1e-3 * bias_mm)
    return replace(bench, eye_tracking=tracking)


def _pupil_moves_with_gaze(bench: Bench, radius_mm: FloatArray) -> Bench:
    radius = bench.eye_tracking.gaze_radius + 1e-3 * float(radius_mm[0])
    return replace(bench, eye_tracking=replace(bench.eye_tracking, gaze_radius=radius))


def _late(bench: Bench, latency_ms: FloatArray) -> Bench:
    return replace(bench, clock=replace(bench.clock, latency_s=bench.clock.latency_s + 1e-3 * float(latency_ms[0])))


def _rows_in_turn(bench: Bench, scanout_ms: FloatArray) -> Bench:
    return replace(bench, clock=replace(bench.clock, scanout_s=bench.clock.scanout_s + 1e-3 * float(scanout_ms[0])))


CAUSES = (
    Cause(
        "eye_position_bias",
        "eye tracking is biased",
        "eye tracking",
        tuple(Parameter(f"bias_{axis}", "mm", 0.5) for axis in "xyz"),
        source="eye tracking of headsets, 0.3 to 1 mm",
        separated_by="real dots at more distances: the error vanishes at the distance of the virtual image",
        variants={"constant": _eye_position_biased},
    ),
    Cause(
        "gaze_pupil_shift",
        "pupil moves with the gaze",
        "eye tracking",
        (Parameter("radius", "mm", 10.5),),
        source="the entrance pupil lies about 10.5 mm before the centre of rotation of the eye",
        separated_by="the same dots looked at directly and from the corner of the eye",
        variants={"about the centre of rotation": _pupil_moves_with_gaze},
    ),
    Cause(
        "latency",
        "latency",
        "clock",
        (Parameter("latency", "ms", 10.0),),
        source="motion-to-photon latency after prediction, a few milliseconds; 3 arcmin per ms at 50 deg/s",
        separated_by="a head that turns at several speeds",
        variants={"constant": _late},
    ),
    Cause(
        "rolling_scanout",
        "rows of the panel light up in turn",
        "clock",
        (Parameter("duration", "ms", 8.0),),
        source="scan-out lasts most of a frame: 8 to 16 ms",
        separated_by="dots at the top and at the bottom of the panel while the head turns",
        variants={"first row first": _rows_in_turn},
    ),
)
