"""Facts about a map for its receiver: headset, eye, pupil, source camera, convention, and losses."""

import json
import math
from dataclasses import asdict
from typing import Any

import numpy as np

from wlr_render.exports.export_view import ALL_COLOURS, ExportedView
from wlr_render.exports.format import Format, Loss
from wlr_render.geometry.directions import arcmin_between, dir_of_tangents
from wlr_render.numerics.arrays import FloatArray

JUDGED_DEPTH_M = 0.5
PUPIL_SHIFT_M = 0.002
_JUDGED_PIXELS = 41
_ALIKE_ARCMIN = 1e-3


def losses(view: ExportedView, form: Format, colour: str) -> list[Loss]:
    """Return the errors of a view in one colour: as intended, at other depths, in other colours, with another pupil.

    Errors are angles at the source camera between the points that the panel's pixels show and should show, by the
    mappings. The pupil moves by `PUPIL_SHIFT_M` to the right, left, up and down in the device, within the eye box; the
    errors are over all these positions.
    """
    mappings, holds = view.mappings(colour), form.holds
    pixel = _pixel_centres(view.panel_size_px)
    due = np.moveaxis(view.rays_at(colour, pixel), -1, 0)
    column, row = np.floor(pixel).astype(int).T
    shown = view.tangents(view.slope_offset(colour)[:, row, column].astype(np.float64))
    if not holds.between_pixels:
        camera = view.source.camera
        shown = camera.tangents_of_pixel(np.floor(camera.pixel_of_tangents(shown)) + 0.5)
    table = []
    if not holds.every_pixel:
        table.append(form.interpolation(view, colour))
    else:
        points = "points at any depth" if holds.every_depth else f"points {depth_words(view.depth_m)}"
        table.append(_loss(f"{points}, as the file is made for", [_arcmin(view, shown, due)]))
    if not holds.every_depth:
        for depth_m in (JUDGED_DEPTH_M, math.inf):
            if depth_m != view.depth_m:
                table.append(_loss(f"points {depth_words(depth_m)}", [_arcmin(view, shown, due, depth_m)]))
    for light, other in view.other_light.items():
        rays = view.rays_of(other, pixel, view.viewpoint)
        table.append(_loss(light, [_arcmin(view, shown, np.moveaxis(rays, -1, 0))]))
    if holds.every_pupil:
        return table
    steps = PUPIL_SHIFT_M * np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]])
    moved = [view.viewpoint + step for step in steps if mappings.eye_box.contains(view.viewpoint + step)]
    errors = [_arcmin(view, shown, np.moveaxis(view.rays_at(colour, pixel, pupil), -1, 0)) for pupil in moved]
    return [*table, _loss(f"pupil displaced by {1e3 * PUPIL_SHIFT_M:g} mm", errors)]


def not_held(view: ExportedView, form: Format) -> list[str]:
    """Return the properties of the headset that a format does not keep, a sentence each."""
    holds, name = form.holds, form.name
    lost = []
    if not holds.every_pupil:
        lost.append(f"{name} holds no moving pupil: a map is right for its own pupil position alone.")
    if not holds.every_depth:
        lost.append(f"{name} holds one depth from the source camera, for the whole picture; the format rays holds all.")
    if view.colours == (ALL_COLOURS,) and not _bends_all_light_alike(view):
        (light,) = view.origin.wavelength_nm.values() or ("the light that the model was fitted in",)
        made_in = f"light of {light:.0f} nm" if isinstance(light, float) else light
        remedy = "--per-colour makes one for each" if holds.colours else f"{name} has no more"
        lost.append(f"One map, made in {made_in}, serves all colours; {remedy}.")
    if not holds.asymmetric_field:
        lost.append(
            f"{name} holds no asymmetric field of view and no turned camera: the source pictures of both eyes reach as "
            "far to the left as to the right, and up as down, in the device's axes; the rest of them is not used."
        )
    if not holds.between_pixels:
        lost.append(f"{name} holds whole pixels of the source picture: up to half a pixel off.")
    if not holds.every_pixel:
        lost.append(f"{name} does not hold every pixel of the panel: its reader interpolates, or evaluates a formula.")
    return lost


def _bends_all_light_alike(view: ExportedView) -> bool:
    """Return whether red and blue light follow the path of green light; False if unknown."""
    pixel, colour = _pixel_centres(view.panel_size_px), view.middle_colour
    green = view.tangents(np.moveaxis(view.rays_at(colour, pixel), -1, 0))
    others = [np.moveaxis(view.rays_of(each, pixel, view.viewpoint), -1, 0) for each in view.other_light.values()]
    # Pixels without a ray compare as False; a panel without rays has no error.
    return bool(others) and not any(np.any(_arcmin(view, green, rays) >= _ALIKE_ARCMIN) for rays in others)


def _pixel_centres(size_px: tuple[int, int]) -> FloatArray:
    """Return the centres (n, 2) of pixels all over a panel."""
    u, v = (np.floor(np.linspace(0, size - 1, _JUDGED_PIXELS)) + 0.5 for size in size_px)
    return np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)


def depth_words(depth_m: float) -> str:
    """Describe the depth of points in words."""
    return f"{depth_m:g} m deep" if math.isfinite(depth_m) else "at infinity"


def _arcmin(view: ExportedView, shown: FloatArray, due: FloatArray, depth_m: float | None = None) -> FloatArray:
    """Return the angles between tangents `shown` (n, 2) and rays `due` (4, n) at a depth, by default the view's."""
    return arcmin_between(dir_of_tangents(shown), dir_of_tangents(view.tangents(due, depth_m)))


def _loss(case: str, errors: list[FloatArray]) -> Loss:
    values = np.concatenate([each.ravel() for each in errors]) if errors else np.empty(0)
    values = values[np.isfinite(values)]
    if not values.size:
        return Loss(case, None, None)
    return Loss(case, float(np.sqrt(np.mean(values**2))), float(values.max()))


def facts(view: ExportedView, colour: str, form: Format) -> dict[str, Any]:
    """Return the facts that a receiver needs about one map, as plain JSON."""
    camera, (left, bottom), (right, top) = view.source.camera, *_borders(view)
    judged = colour if colour in view.colours else view.middle_colour  # of all colours, the middle one is judged
    return {
        "format": "wlr-export",
        "version": 1,
        "kind": form.name,
        "headset": view.origin.name,
        "sha256": dict(view.origin.sha256),
        "eye": view.eye,
        "colour": colour,
        "wavelength_nm": _wavelength(view, colour),
        "frame": "openxr",
        "viewpoint_in_device_m": view.viewpoint.tolist(),
        **({"time_s": view.time_s} if view.time_s is not None else {}),
        "depth_m": "every" if form.holds.every_depth else _depth_number(view.depth_m),
        "panel_size_px": list(view.panel_size_px),
        "source_camera": {
            "size_px": list(camera.size_px),
            "tangents": {"left": left, "right": right, "bottom": bottom, "top": top},
            "position_in_device_m": view.source.position_in_device.tolist(),
            "device_from_camera": view.source.device_from_camera.tolist(),
        },
        "convention": list(form.convention),
        "does_not_hold": not_held(view, form),
        "loses": [asdict(loss) for loss in losses(view, form, judged)],
        "predicted_error": _predicted_error(view, judged),
    }


def _predicted_error(view: ExportedView, colour: str) -> dict[str, Any] | None:
    found = view.predicted_error(colour)
    return found if found is None else {"depth_m": _depth_number(view.depth_m), **found}


def _wavelength(view: ExportedView, colour: str) -> float | dict[str, float] | str:
    wavelengths = view.origin.wavelength_nm
    return wavelengths.get(colour, dict(wavelengths)) if wavelengths else "as the models were fitted"


def _borders(view: ExportedView) -> tuple[list[float], list[float]]:
    camera = view.source.camera
    return np.asarray(camera.tangent_min).tolist(), np.asarray(camera.tangent_max).tolist()


def _depth_number(depth_m: float) -> float | str:
    """Return a depth in metres, or "infinity", as JSON has no such number."""
    return depth_m if math.isfinite(depth_m) else "infinity"


def header_texts(record: dict[str, Any]) -> dict[str, str]:
    """Return the facts as the texts of a header."""
    return {key: value if isinstance(value, str) else json.dumps(value) for key, value in record.items()}
