"""Causes in the headset: combiner, panel, media, and how the panel is read out."""

from dataclasses import replace

import numpy as np

from wlr_render.diagnosis.cause import Cause, Parameter, Role
from wlr_render.diagnosis.causes.device_changes import (
    combiner_middle,
    combiner_shifted,
    combiner_thickened,
    combiner_turned,
    index_shifted,
    panel_moved,
    panel_scaled,
    plate_added,
)
from wlr_render.numerics.arrays import FloatArray
from wlr_render.simulation.bench import Bench

_UNITS = "spread (1.48 MAD) of 16 calibrated Project North Star units about their CAD"


def _combiner_turned(bench: Bench, tilt_deg: FloatArray) -> Bench:
    return combiner_turned(bench, tilt_deg, combiner_middle(bench))


def _combiner_shifted(bench: Bench, shift_mm: FloatArray) -> Bench:
    return combiner_shifted(bench, 1e-3 * shift_mm)


def _panel_shifted(bench: Bench, shift_mm: FloatArray) -> Bench:
    return panel_moved(bench, shift=1e-3 * np.append(shift_mm, 0.0))


def _panel_shifted_along_normal(bench: Bench, shift_mm: FloatArray) -> Bench:
    return panel_moved(bench, shift=1e-3 * np.array([0.0, 0.0, shift_mm[0]]))


def _panel_turned(bench: Bench, turn_deg: FloatArray) -> Bench:
    return panel_moved(bench, turn=np.deg2rad(turn_deg))


def _panel_scaled(bench: Bench, scale_percent: FloatArray) -> Bench:
    return panel_scaled(bench, 1.0 + 1e-2 * float(scale_percent[0]))


def _index_shifted(bench: Bench, index: FloatArray) -> Bench:
    return index_shifted(bench, float(index[0]))


def _outer_along_axis(bench: Bench, thickness_mm: FloatArray) -> Bench:
    return combiner_thickened(bench, 1e-3 * float(thickness_mm[0]), "outer", along_axis=True)


def _outer_along_normals(bench: Bench, thickness_mm: FloatArray) -> Bench:
    return combiner_thickened(bench, 1e-3 * float(thickness_mm[0]), "outer")


def _inner_along_normals(bench: Bench, thickness_mm: FloatArray) -> Bench:
    return combiner_thickened(bench, 1e-3 * float(thickness_mm[0]), "inner")


def _plate_tilted(bench: Bench, values: FloatArray) -> Bench:
    return plate_added(bench, 1e-3 * float(values[0]), tilt_deg=values[1:])


def _plate_wedged(bench: Bench, values: FloatArray) -> Bench:
    return plate_added(bench, 1e-3 * float(values[0]), wedge_deg=values[1:])


def _colours_magnified(bench: Bench, scale_percent: FloatArray) -> Bench:
    red, blue = 1e-2 * scale_percent
    scale = bench.readout.channel_scale * (1.0 + np.array([red, 0.0, blue]))
    return replace(bench, readout=replace(bench.readout, channel_scale=scale))


def _panel_pixels_offset(bench: Bench, offset_px: FloatArray) -> Bench:
    return replace(bench, readout=replace(bench.readout, origin_px=bench.readout.origin_px + offset_px))


def _camera_pixels_offset(bench: Bench, offset_px: FloatArray) -> Bench:
    return replace(bench, camera=replace(bench.camera, centre_px=bench.camera.centre_px + offset_px))


OPTICS = (
    Cause(
        "combiner_tilt",
        "combiner tilted",
        "device",
        tuple(Parameter(f"tilt_{axis}", "deg", 1.0) for axis in "xyz"),
        source=f"{_UNITS}: 1.3 to 2.4 deg to the screen",
        separated_by="see-through captures of a near target: a shift of the panel leaves them alone, a tilt does not",
        variants={"about its middle": _combiner_turned},
    ),
    Cause(
        "combiner_shift",
        "combiner displaced",
        "device",
        tuple(Parameter(f"shift_{axis}", "mm", 1.5) for axis in "xyz"),
        source=f"{_UNITS}: 1.0, 2.0, 1.6 mm",
        separated_by="see-through captures of a near target, and display captures farther off the base plane",
        variants={"as a whole": _combiner_shifted},
    ),
    Cause(
        "panel_shift",
        "panel displaced in its plane",
        "device",
        tuple(Parameter(f"shift_{axis}", "mm", 1.0) for axis in "uv"),
        source=f"{_UNITS}: 0.7 and 2.5 mm",
        separated_by="a photograph of the bare panel against its frame; display captures farther off the base plane",
        variants={"along u and v": _panel_shifted},
    ),
    Cause(
        "panel_axial_shift",
        "panel displaced along its normal",
        "device",
        (Parameter("shift", "mm", 0.5),),
        source=f"{_UNITS}: 0.5 mm",
        separated_by="display captures over a deeper eye box: a magnified panel swims differently from a displaced one",
        variants={"along the normal": _panel_shifted_along_normal},
    ),
    Cause(
        "panel_rotation",
        "panel turned about its centre",
        "device",
        (Parameter("about_u", "deg", 1.0), Parameter("about_v", "deg", 1.0), Parameter("roll", "deg", 1.0)),
        source=f"{_UNITS}: 1.3 to 2.4 deg of the normal",
        separated_by="a photograph of the bare panel against its frame",
        variants={"about its centre": _panel_turned},
    ),
    Cause(
        "panel_scale",
        "panel larger than stated",
        "device",
        (Parameter("scale", "%", 0.3),),
        source="rounding of a pixel pitch in a data sheet, a few parts in a thousand; heat is ten times less",
        separated_by="a photograph of the bare panel with a ruler",
        variants={"about its centre": _panel_scaled},
    ),
    Cause(
        "substrate_index",
        "refractive index of the substrate",
        "device",
        (Parameter("index", "1", 0.01),),
        source="PMMA grades differ by 0.002, PMMA and polycarbonate by 0.09; a moulded part lies between",
        separated_by="the index of a witness piece; a second wavelength",
        variants={"of all media": _index_shifted},
    ),
    Cause(
        "substrate_thickness",
        "thickness of the combiner",
        "device",
        (Parameter("thickness", "mm", 0.1),),
        source="usual tolerance of moulded plastic optics, 0.05 to 0.1 mm",
        separated_by="a calliper",
        variants={
            "its outer face moves along its normals": _outer_along_normals,
            "its outer face moves along its axis": _outer_along_axis,
            "its inner face moves along its normals": _inner_along_normals,
        },
    ),
    Cause(
        "see_through_plate",
        "thick plate in the see-through path",
        "device",
        (
            Parameter("thickness", "mm", 5.0, minimum=0.0),
            Parameter("angle_x", "deg", 20.0, Role.SHAPE),
            Parameter("angle_y", "deg", 20.0, Role.SHAPE),
        ),
        source="cover and prism plates of optical see-through headsets, 1 to 20 mm",
        separated_by="the target at more distances: the offset by a plate goes with 1 / distance, a lens's does not",
        variants={
            "plane-parallel, tilted by the angles": _plate_tilted,
            "facing the eye, a wedge of the angles": _plate_wedged,
        },
    ),
)
READOUT = (
    Cause(
        "lateral_colour",
        "lateral colour",
        "device",
        (Parameter("red", "%", 0.3), Parameter("blue", "%", 0.3)),
        source="2.4 arcmin at 14 deg in a see-through headset, 20 arcmin at 44 deg in a lens of virtual reality",
        separated_by="captures in all three colours from the same positions",
        variants={"about the panel's centre": _colours_magnified},
    ),
    Cause(
        "pixel_origin",
        "pixels counted from elsewhere",
        "device",
        (Parameter("offset_u", "px", 0.5), Parameter("offset_v", "px", 0.5)),
        source="conventions put the origin at the centre or at the corner of the first pixel",
        separated_by="a single lit pixel at a known place, decoded by the same software",
        variants={"of the panel": _panel_pixels_offset, "of the camera": _camera_pixels_offset},
        whole_steps=0.5,
    ),
)
