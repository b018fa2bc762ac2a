"""Convert the readings of a bench session to captures, assuming its nominal bench.

The camera, stage, target, tracking and readout of a bench turn camera pixels into viewpoints, directions and real
points of the device frame. Only the headset's optics are left out: they are what calibration is to find.
"""

import numpy as np

from wlr_render.captures.correspondences import DisplayCaptures, EyeCaptures, SeeThroughCaptures
from wlr_render.captures.session import DisplayPlan, SeeThroughPlan, Session, select_rows
from wlr_render.errors import BadInputError
from wlr_render.geometry.directions import ARCMIN, dir_of_tangents
from wlr_render.numerics.arrays import FloatArray, IntArray
from wlr_render.simulation.bench import Bench, EyeballCamera
from wlr_render.simulation.simulate_session import (
    camera_positions,
    display_dirs,
    dot_geometry,
    undecoded,
)

_GREEN = 1


def captures_of(bench: Bench, session: Session) -> EyeCaptures:
    """Captures of the bench's eye; its device's optics do not enter, its panel and eye box do.

    Raises:
        BadInputError: the session has no readings of the panel, or by this bench a dot lies behind the camera.
    """
    plan, readings = session.plan, session.readings
    if plan.display is None or readings.panel_pixel is None:
        raise BadInputError(f"{session.name}: has no display table, so there is no display to calibrate; add one.")
    display = display_captures(bench, plan.display, readings.panel_pixel)
    if plan.see_through is None or readings.dot_pixel is None:
        return EyeCaptures(display)
    return EyeCaptures(display, see_through_captures(bench, plan.see_through, readings.dot_pixel))


def display_captures(bench: Bench, plan: DisplayPlan, panel_pixel: FloatArray) -> DisplayCaptures:
    """Of one colour channel, green where there is a choice: calibration fits one wavelength.

    Args:
        bench: what is believed of camera, stage, mount and readout.
        plan: what was set up.
        panel_pixel: (n, 2) decoded positions; rows with NaN are left out.
    """
    channel = _GREEN if np.any(plan.channel == _GREEN) else plan.channel.min(initial=_GREEN)
    kept = np.asarray((plan.channel == channel) & np.isfinite(panel_pixel).all(axis=1))
    rows = select_rows(plan, kept)
    return DisplayCaptures(
        device=bench.device.name,
        eye=bench.eye,
        eye_box=bench.optics.eye_box,
        panel=bench.optics.panel.pixels,
        viewpoint=camera_positions(bench, rows),
        view_dir=display_dirs(bench, rows),
        pixel=undecoded(bench, rows, panel_pixel[kept]),
        capture=rows.capture,
        sigma_arcmin=_sigma_arcmin(bench.camera, rows.camera_pixel),
    )


def see_through_captures(bench: Bench, plan: SeeThroughPlan, dot_pixel: FloatArray) -> SeeThroughCaptures:
    """Of all poses of the target; photographs are numbered on from pose to pose.

    Args:
        bench: what is believed of camera, stage, mount, target and tracking.
        plan: what was set up.
        dot_pixel: (n, 2) camera pixels; rows with NaN are left out.
    """
    kept = np.asarray(np.isfinite(dot_pixel).all(axis=1))
    rows, pixel = select_rows(plan, kept), dot_pixel[kept]
    viewpoint, point, device_from_camera = dot_geometry(bench, rows)
    in_camera = dir_of_tangents(bench.camera.tangents_of_pixel(pixel))
    return SeeThroughCaptures(
        device=bench.device.name,
        eye=bench.eye,
        eye_box=bench.optics.eye_box,
        viewpoint=viewpoint,
        view_dir=np.einsum("nij,nj->ni", device_from_camera, in_camera),
        point=point,
        capture=_numbered_on(rows),
        target_pose=rows.target_pose,
        sigma_arcmin=_sigma_arcmin(bench.camera, pixel),
    )


def _numbered_on(rows: SeeThroughPlan) -> IntArray:
    """Numbers (n,) of the photographs: those of a session count from 0 for every pose of the target."""
    pairs = np.stack([rows.target_pose, rows.capture], axis=1)
    return np.asarray(np.unique(pairs, axis=0, return_inverse=True)[1].reshape(-1), dtype=np.int64)


def _sigma_arcmin(camera: EyeballCamera, pixel: FloatArray) -> FloatArray:
    """The stated repeatability as an angle in each pixel (n, 2): the geometric mean of radially and across, (n,)."""
    square = np.sum(camera.tangents_of_pixel(pixel) ** 2, axis=1)
    on_axis = camera.point_sigma_px / np.sqrt(np.prod(camera.focal_px)) / ARCMIN
    return np.asarray(on_axis * (1.0 + square) ** -0.75)
