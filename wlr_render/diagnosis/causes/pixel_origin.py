"""Pixels are counted from elsewhere: half a pixel, or a whole one, between two conventions."""

from dataclasses import replace

from wlr_render.diagnosis.cause import Cause, Parameter
from wlr_render.numerics.arrays import FloatArray
from wlr_render.simulation.bench import Bench


def _of_the_panel(bench: Bench, offset_px: FloatArray) -> Bench:
    return replace(bench, readout=replace(bench.readout, origin_px=bench.readout.origin_px + offset_px))


def _of_the_camera(bench: Bench, offset_px: FloatArray) -> Bench:
    return replace(bench, camera=replace(bench.camera, centre_px=bench.camera.centre_px + offset_px))


CAUSE = Cause(
    "pixel_origin",
    "pixels counted from elsewhere",
    "device",
    (Parameter("offset_u", "px", 0.5), Parameter("offset_v", "px", 0.5)),
    source="conventions put the origin at the centre or at the corner of the first pixel",
    separated_by="a single lit pixel at a known place, decoded by the same software",
    variants={"of the panel": _of_the_panel, "of the camera": _of_the_camera},
    whole_steps=0.5,
)
