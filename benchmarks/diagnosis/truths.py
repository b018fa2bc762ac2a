"""True parameter values of hidden effects, in the parameters of the causes.

The generator's axes are x right, y down, z forward, in millimetres; the causes' axes are x right, y up, z backward. The
frames differ by half a turn about x, so that vectors and rotation vectors transform in the same way.
"""

from collections.abc import Callable, Mapping

import numpy as np
from oracle.captures import Plan
from oracle.devices import own_device
from oracle.effects import Effect
from oracle.own_tracer import turn
from oracle.recipes import Amount
from oracle.run_time import RunTimePlan

Truth = Mapping[str, float]
"""True values by the names of the cause's parameters, in their units."""

Convert = Callable[[Amount, Plan | RunTimePlan], Truth]

_BOW_REFERENCE_MM = 400.0
_BOW_DOTS = 10  # distance from the middle of the first target, in dots, to which the cause's sag refers
_EDGE_PX, _FOCAL_PX = 640.0, 1350.0


def truth_of(effect: Effect, plan: Plan | RunTimePlan) -> Truth:
    """Return the perfect diagnosis of an effect; empty for an effect that is not a listed cause.

    The thickness of the see-through plate is omitted: the generator's glass differs from the cause's.
    """
    convert = _CONVERSIONS.get(effect.name)
    return convert(effect.amount, plan) if convert else {}


def _vector(name: str, unit: str) -> Convert:
    def convert(amount: Amount, plan: Plan | RunTimePlan) -> Truth:
        x, y, z = (amount[f"{axis}_{unit}"] for axis in "xyz")
        return {f"{name}_x": x, f"{name}_y": -y, f"{name}_z": -z}

    return convert


def _same(**key_of: str) -> Convert:
    """Return the parameters that are amounts under another name."""
    return lambda amount, plan: {name: amount[key] for name, key in key_of.items()}


def _stage_scale(amount: Amount, plan: Plan | RunTimePlan) -> Truth:
    return {f"scale_{axis}": amount[f"{axis}_percent"] for axis in "xyz"}


def _stage_backlash(amount: Amount, plan: Plan | RunTimePlan) -> Truth:
    return {"lost_motion": -amount["lost_mm"]}


def _panel_rotation(amount: Amount, plan: Plan | RunTimePlan) -> Truth:
    return {"about_u": 0.0, "about_v": 0.0, "roll": amount["angle_deg"]}


def _camera_distortion(amount: Amount, plan: Plan | RunTimePlan) -> Truth:
    return {"k1": amount["edge_px"] / _EDGE_PX / (_EDGE_PX / _FOCAL_PX) ** 2, "k2": 0.0}


def _see_through_plate(amount: Amount, plan: Plan | RunTimePlan) -> Truth:
    x, y, z = turn(np.radians([amount["tilt_x_deg"], amount["tilt_y_deg"], 0.0]))[:, 2]
    return {"angle_x": float(np.degrees(np.arctan2(-y, z))), "angle_y": float(np.degrees(np.arcsin(-x)))}


def _target_bow(amount: Amount, plan: Plan | RunTimePlan) -> Truth:
    assert isinstance(plan, Plan)
    sag = -amount["bow_mm"] * (_BOW_DOTS * plan.pitch_mm(0) / _BOW_REFERENCE_MM) ** 2
    return {"sag_x": sag, "sag_y": sag * amount["second_ratio"]}


def _lateral_colour(amount: Amount, plan: Plan | RunTimePlan) -> Truth:
    shifts = {f"{colour}_{axis}": 0.0 for colour in ("red", "blue") for axis in "uv"}
    return {"red": amount["scale_percent"], "blue": -amount["scale_percent"]} | shifts


def _panel_bow(amount: Amount, plan: Plan | RunTimePlan) -> Truth:
    square = (0.5 * own_device(plan.device).panel.size_mm) ** 2
    sag_u, sag_v = amount["corner_mm"] * square / square.sum()
    return {"sag_u": float(sag_u), "sag_v": float(sag_v)}


def _combiner_form(amount: Amount, plan: Plan | RunTimePlan) -> Truth:
    others = dict.fromkeys(("power", "oblique_astigmatism", "coma_x", "coma_y"), 0.0)
    return {**others, "astigmatism": 1e3 * amount["sag_mm"]}


def _combiner_dent(amount: Amount, plan: Plan | RunTimePlan) -> Truth:
    return {
        "depth": 1e3 * amount["depth_mm"],
        "x": amount["x_mm"],
        "y": -amount["y_mm"],
        "width": amount["width_mm"],
    }


def _headset_slip(amount: Amount, plan: Plan | RunTimePlan) -> Truth:
    return {**_vector("shift", "mm")(amount, plan), "turn_x": 0.0, "turn_y": 0.0, "turn_z": 0.0}


_CONVERSIONS: Mapping[str, Convert] = {
    "combiner_tilt": _vector("tilt", "deg"),
    "combiner_shift": _vector("shift", "mm"),
    "frame_bend": _same(toe_in="toe_in_deg", twist="twist_deg"),
    "panel_shift": _same(shift_u="x_mm", shift_v="y_mm"),
    "panel_axial_shift": _same(shift="shift_mm"),
    "panel_rotation": _panel_rotation,
    "panel_scale": _same(scale_u="scale_percent", scale_v="scale_percent"),
    "substrate_index": _same(index="index"),
    "substrate_thickness": _same(thickness="thickness_mm"),
    "see_through_plate": _see_through_plate,
    "panel_bow": _panel_bow,
    "combiner_form": _combiner_form,
    "combiner_dent": _combiner_dent,
    "stage_scale": _stage_scale,
    "stage_tilt": _vector("tilt", "deg"),
    "stage_backlash": _stage_backlash,
    "camera_pupil_offset": _vector("offset", "mm"),
    "camera_rotation": _vector("turn", "deg"),
    "camera_focal_length": _same(scale="focal_percent"),
    "camera_distortion": _camera_distortion,
    "target_scale": _same(scale_x="scale_percent", scale_y="scale_percent"),
    "target_bow": _target_bow,
    "tracking_rotation": _vector("turn", "deg"),
    "tracking_translation": _vector("shift", "mm"),
    "thermal_drift": _same(creep_u="x_mm", creep_v="y_mm", time_constant="tau_s"),
    "headset_slip": _headset_slip,
    "eye_position_bias": _vector("bias", "mm"),
    "gaze_pupil_shift": _same(radius="radius_mm"),
    "latency": _same(latency="latency_ms"),
    "rolling_scanout": _same(duration="duration_ms"),
    "lateral_colour": _lateral_colour,
    "pixel_origin": _same(offset_u="offset_px", offset_v="offset_px"),
}
