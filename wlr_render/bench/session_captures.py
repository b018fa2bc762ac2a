"""Conversion of a bench session's readings to observations of an eye and back, based on the nominal bench.

The camera, stage, target, tracking and readout of the bench convert camera pixels to viewpoints, directions and real
points in the device frame. The headset's optics are not used, because calibration estimates them.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from wlr_render.bench.bench import Bench, EyeballCamera
from wlr_render.bench.simulate_session import (
    camera_orientations,
    camera_positions,
    decoded,
    display_dirs,
    dot_geometry,
    imaged,
    mounted,
    printed_places,
    slips,
    stage_readings,
    undecoded,
    unshifted,
)
from wlr_render.captures.correspondences import Captures, DisplayCaptures, SeeThroughCaptures
from wlr_render.captures.feature_captures import FeatureCaptures
from wlr_render.captures.session import (
    DisplayPlan,
    Readings,
    SeeThroughPlan,
    Session,
    SessionPlan,
    StagePlan,
    select_rows,
)
from wlr_render.errors import BadInputError
from wlr_render.geometry.directions import ARCMIN, dir_of_tangents, tangents_of_dir
from wlr_render.numerics.arrays import FloatArray, IntArray

_GREEN = 1
_DECIMALS = 12  # decimals of metres and rotations, so that rows of one photograph have exactly one setup
_FLAT_M = 1e-9
_SAME_SIGMA = 1e-6  # largest relative difference of equal sigmas, due to rounding
LEAST_SIGMA_PX = 1e-3
"""Least sigma of a reading, used for exact captures, camera pixels."""
_OFF_TARGET_M = 0.05  # largest distance of dots from the target's plane; no target is curved by more


def captures_of(bench: Bench, session: Session) -> Captures:
    """Return the captures of a session's panel in all colours and of its targets, without use of the device's optics.

    Raises:
        BadInputError: the session has neither, or a dot lies behind the camera of this bench.
    """
    plan, readings = session.plan, session.readings
    display = see_through = None
    if plan.display is not None and readings.panel_pixel is not None:
        kept = np.asarray(np.isfinite(readings.panel_pixel).all(axis=1))
        display = _display(bench, select_rows(plan.display, kept), readings.panel_pixel[kept])
    if plan.see_through is not None and readings.dot_pixel is not None:
        see_through = see_through_captures(bench, plan.see_through, readings.dot_pixel)
    return Captures(display, see_through, bench.optics.panel.pixels)


def display_captures(bench: Bench, plan: DisplayPlan, panel_pixel: FloatArray) -> DisplayCaptures:
    """Return the display captures of one colour channel, green if present, because calibration fits one wavelength.

    Args:
        bench: bench with the assumed camera, stage, mount and readout.
        plan: setup of each row.
        panel_pixel: (n, 2) decoded positions; rows with NaN are left out.
    """
    channel = _GREEN if np.any(plan.channel == _GREEN) else plan.channel.min(initial=_GREEN)
    kept = np.asarray((plan.channel == channel) & np.isfinite(panel_pixel).all(axis=1))
    return _display(bench, select_rows(plan, kept), panel_pixel[kept])


def _display(bench: Bench, rows: DisplayPlan, panel_pixel: FloatArray) -> DisplayCaptures:
    return DisplayCaptures(
        panel=bench.optics.panel.pixels,
        viewpoint=camera_positions(bench, rows),
        view_dir=display_dirs(bench, rows),
        pixel=undecoded(bench, rows, panel_pixel),
        capture=rows.capture,
        channel=rows.channel,
        **_common(bench, rows, rows.camera_pixel),
    )


def see_through_captures(bench: Bench, plan: SeeThroughPlan, dot_pixel: FloatArray) -> SeeThroughCaptures:
    """Return the see-through captures of all target poses, with photographs numbered consecutively through all poses.

    Args:
        bench: bench with the assumed camera, stage, mount, target and tracking.
        plan: setup of each row.
        dot_pixel: (n, 2) camera pixels; rows with NaN are left out.
    """
    kept = np.asarray(np.isfinite(dot_pixel).all(axis=1))
    rows, pixel = select_rows(plan, kept), dot_pixel[kept]
    viewpoint, point, device_from_camera = dot_geometry(bench, rows)
    in_camera = dir_of_tangents(bench.camera.tangents_of_pixel(unshifted(bench, rows, pixel)))
    height = np.zeros(len(rows)) if rows.height is None else rows.height
    return SeeThroughCaptures(
        viewpoint=viewpoint,
        view_dir=np.einsum("nij,nj->ni", device_from_camera, in_camera),
        point=point,
        capture=_numbered_on(rows),
        target_pose=rows.target_pose,
        target_point=np.column_stack([rows.dot, height]),
        **_common(bench, rows, pixel),
    )


def session_of(bench: Bench, captures: Captures, name: str) -> Session:
    """Return the session of these captures, the inverse of `captures_of`, for any bench.

    Defaults for values that were not recorded are time 0, a move towards +x, green light, and the camera rotation of
    the bench.

    Args:
        bench: bench with the poses of all targets.
        captures: captures of the bench's eye.
        name: name of the session.

    Raises:
        BadInputError: the captures are of another eye, or impossible with the bench's camera or targets.
    """
    source, display, see_through = captures.source, captures.display, captures.see_through
    if (source.device, source.eye) != (bench.device.name, bench.eye):
        raise BadInputError(
            f"{name}: the captures are of {source.device} ({source.eye} eye), the bench is of {bench.device.name} "
            f"({bench.eye} eye); choose a bench or a device of that headset."
        )
    display_plan = see_through_plan = panel_pixel = dot_pixel = None
    if display is not None:
        display_plan = _display_plan(bench, display, name)
        panel_pixel = decoded(bench, display_plan, display.pixel)
    if see_through is not None:
        see_through_plan, dot_pixel = _see_through_plan(bench, see_through, name)
    return Session(name, SessionPlan(display_plan, see_through_plan), Readings(panel_pixel, dot_pixel))


def _display_plan(bench: Bench, captures: DisplayCaptures, name: str) -> DisplayPlan:
    channel = np.where(captures.channel >= 0, captures.channel, _GREEN)
    time_s, travel = _moments(captures)
    empty = np.zeros((len(captures), 2))
    plan = DisplayPlan(_numbers(captures), time_s, travel, captures.viewpoint, channel, empty)
    readings, pixel = _camera_readings(bench, plan, captures, name)
    return replace(plan, camera_pixel=pixel, **readings)


def _see_through_plan(bench: Bench, captures: SeeThroughCaptures, name: str) -> tuple[SeeThroughPlan, FloatArray]:
    poses, highest = len(bench.target.pitch), int(captures.target_pose.max())
    if highest >= poses or captures.target_pose.min() < 0:
        raise BadInputError(
            f"{name}: the captures name target pose {highest}, but the bench has {poses} [[target_pose]], counted from "
            "0; add the missing ones, or leave all out to use the poses of the captures."
        )
    time_s, travel = _moments(captures)
    empty = np.zeros((len(captures), 2))
    rows = SeeThroughPlan(_numbers(captures), time_s, travel, captures.viewpoint, captures.target_pose, empty)
    dot, height = printed_places(bench, rows, captures.point)
    if (off := float(np.abs(height).max())) > _OFF_TARGET_M:
        raise BadInputError(
            f"{name}: dots lie up to {1e3 * off:.0f} mm off the targets of the bench; correct its [[target_pose]], or "
            "leave all out to use the poses of the captures."
        )
    readings, pixel = _camera_readings(bench, rows, captures, name)
    raised = None if np.abs(height).max() < _FLAT_M else height
    return replace(rows, dot=dot, height=raised, **readings), pixel


def _camera_readings(
    bench: Bench, plan: StagePlan, captures: FeatureCaptures, name: str
) -> tuple[dict[str, Any], FloatArray]:
    """Return `stage`, `orientation` and `sigma_px` of a plan and the camera pixels (n, 2), from captures.

    Args:
        bench: the assumed bench.
        plan: plan of the captures, with time and travel.
        captures: viewpoints, directions and camera rotations.
        name: name of the session.
    """
    stage = np.round(stage_readings(bench, plan, captures.viewpoint), _DECIMALS)
    plan = replace(plan, stage=stage)
    as_stated = camera_orientations(bench, plan)
    turned = np.where(np.isfinite(captures.device_from_camera), captures.device_from_camera, as_stated)
    in_camera = np.einsum("nji,nj->ni", turned, captures.view_dir)
    if np.any(in_camera[:, 2] >= 0):
        raise BadInputError(f"{name}: by [camera] 'rotation' of the bench, the camera looks back; correct it.")
    pixel = imaged(bench, plan, bench.camera.pixel_of_tangents(tangents_of_dir(in_camera)))
    unslipped = np.swapaxes(slips(bench, plan.time_s), 1, 2)
    orientation = np.round(unslipped @ turned @ np.swapaxes(mounted(bench, plan), 1, 2), _DECIMALS)
    turns = None if np.array_equal(orientation, np.tile(np.eye(3), (len(plan), 1, 1))) else orientation
    return {"stage": stage, "orientation": turns, "sigma_px": _sigmas(bench.camera, captures, pixel)}, pixel


def _common(bench: Bench, rows: StagePlan, pixel: FloatArray) -> dict[str, Any]:
    """Return the columns common to captures of the panel and of targets, given the camera pixels (n, 2)."""
    sigma_px = bench.camera.point_sigma_px if rows.sigma_px is None else rows.sigma_px
    return {
        "device": bench.device.name,
        "eye": bench.eye,
        "eye_box": bench.optics.eye_box,
        "sigma_arcmin": sigma_px * _arcmin_per_px(bench.camera, pixel),
        "visit": rows.capture,
        "time_s": rows.time_s,
        "travel": rows.travel,
        "stage": rows.stage,
        "device_from_camera": camera_orientations(bench, rows),
    }


def _moments(captures: FeatureCaptures) -> tuple[FloatArray, FloatArray]:
    """Return the times (n,) and the directions (n,) of the last move, with defaults where not recorded."""
    return np.nan_to_num(captures.time_s), np.where(np.isfinite(captures.travel), captures.travel, 1.0)


def _numbers(captures: FeatureCaptures) -> IntArray:
    """Return the numbers (n,) of the photographs: the visits if recorded, else the camera positions."""
    return captures.visit if captures.has_visits else captures.capture


def _numbered_on(rows: SeeThroughPlan) -> IntArray:
    """Return consecutive numbers (n,) of a session's photographs, which count from 0 for every pose of the target."""
    pairs = np.stack([rows.target_pose, rows.capture], axis=1)
    return np.asarray(np.unique(pairs, axis=0, return_inverse=True)[1].reshape(-1), dtype=np.int64)


def _sigmas(camera: EyeballCamera, captures: FeatureCaptures, pixel: FloatArray) -> FloatArray | None:
    """Return the sigmas (n,) of captures in camera pixels; None if they are exact or have the camera's sigma."""
    sigma_px = captures.sigma_arcmin / _arcmin_per_px(camera, pixel)
    if not sigma_px.any() or np.allclose(sigma_px, camera.point_sigma_px, rtol=_SAME_SIGMA, atol=0.0):
        return None
    return np.maximum(sigma_px, LEAST_SIGMA_PX)


def _arcmin_per_px(camera: EyeballCamera, pixel: FloatArray) -> FloatArray:
    """Return the angle (n,) of camera pixels (n, 2), the geometric mean of radial and tangential angle."""
    square = np.sum(camera.tangents_of_pixel(pixel) ** 2, axis=1)
    return np.asarray((1.0 + square) ** -0.75 / np.sqrt(np.prod(camera.focal_px)) / ARCMIN)
