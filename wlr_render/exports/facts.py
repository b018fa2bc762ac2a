"""What a receiver must know about a map: from which headset, eye and pupil, for which camera, and what it loses."""

import json
import math
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from wlr_render.exports.format import Carries, Format
from wlr_render.exports.view import ExportedView
from wlr_render.files import write_text
from wlr_render.geometry.directions import arcmin_between, dir_of_tangents
from wlr_render.numerics.arrays import FloatArray

JUDGED_DEPTH_M = 0.5
PUPIL_SHIFT_M = 0.002
_JUDGED_PIXELS = 41


@dataclass(frozen=True)
class Loss:
    """Misalignment over the panel where a fixed map is used for what it was not made for.

    Attributes:
        case: in words.
        rms_arcmin, max_arcmin: over a grid of panel pixels that have a ray; None where the case is not defined.
    """

    case: str
    rms_arcmin: float | None
    max_arcmin: float | None


def losses(view: ExportedView, carries: Carries, colour: str) -> list[Loss]:
    """What the numbers of a view lose in one colour, as it was made for, at `JUDGED_DEPTH_M`, and with another pupil.

    The first one is left out where the format approximates between panel pixels: its page has the tolerance.

    Directions are those from the source camera to the points that the panel's pixels show and should show, by the
    mappings. The pupil moves `PUPIL_SHIFT_M` right, left, up and down in the device, as far as the eye box allows; the
    errors are of all these together.
    """
    mappings = view.mappings(colour)
    pixel = _pixel_centres(view.panel_size_px)
    due = np.moveaxis(view.rays_at(colour, pixel), -1, 0)
    column, row = np.floor(pixel).astype(int).T
    shown = view.tangents(view.slope_offset(colour)[:, row, column].astype(np.float64))
    if not carries.between_pixels:
        camera = view.source.camera
        shown = camera.tangents_of_pixel(np.floor(camera.pixel_of_tangents(shown)) + 0.5)
    found = []
    if carries.every_pixel:
        points = "points at any depth" if carries.every_depth else f"points {depth_words(view.depth_m)}"
        found.append(_loss(f"{points}, as the file is made for", [_arcmin(view, shown, due)]))
    if not carries.every_depth:
        found.append(_loss(f"points {depth_words(JUDGED_DEPTH_M)}", [_arcmin(view, shown, due, JUDGED_DEPTH_M)]))
    steps = PUPIL_SHIFT_M * np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]])
    moved = [view.viewpoint + step for step in steps if mappings.eye_box.contains(view.viewpoint + step)]
    errors = [_arcmin(view, shown, np.moveaxis(view.rays_at(colour, pixel, pupil), -1, 0)) for pupil in moved]
    return [*found, _loss(f"pupil {1e3 * PUPIL_SHIFT_M:g} mm aside", errors)]


def _pixel_centres(size_px: tuple[int, int]) -> FloatArray:
    """Centres (n, 2) of pixels all over a panel."""
    u, v = (np.floor(np.linspace(0, size - 1, _JUDGED_PIXELS)) + 0.5 for size in size_px)
    return np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)


def depth_words(depth_m: float) -> str:
    """Where points of a depth are."""
    return f"{depth_m:g} m deep" if math.isfinite(depth_m) else "at infinity"


def _arcmin(view: ExportedView, shown: FloatArray, due: FloatArray, depth_m: float | None = None) -> FloatArray:
    """Angles between tangents (n, 2) that are shown and those of rays (4, n) at a depth, by default the view's."""
    return arcmin_between(dir_of_tangents(shown), dir_of_tangents(view.tangents(due, depth_m)))


def _loss(case: str, errors: list[FloatArray]) -> Loss:
    values = np.concatenate([each.ravel() for each in errors]) if errors else np.empty(0)
    values = values[np.isfinite(values)]
    if not values.size:
        return Loss(case, None, None)
    return Loss(case, float(np.sqrt(np.mean(values**2))), float(values.max()))


def facts(view: ExportedView, colour: str, form: Format) -> dict[str, Any]:
    """All that a receiver must know about one map, as plain JSON."""
    camera, (left, bottom), (right, top) = view.source.camera, *_borders(view)
    judged = colour if colour in view.colours else view.middle_colour  # of a file of all colours, the middle one
    return {
        "format": "wlr-export",
        "version": 1,
        "kind": form.name,
        "headset": view.origin.name,
        "sha256": dict(view.origin.sha256),
        "eye": view.eye,
        "colour": colour,
        "frame": "openxr",
        "viewpoint_in_device_m": view.viewpoint.tolist(),
        **({"time_s": view.time_s} if view.time_s is not None else {}),
        "depth_m": "every" if form.carries.every_depth else _depth_number(view.depth_m),
        "panel_size_px": list(view.panel_size_px),
        "source_camera": {
            "size_px": list(camera.size_px),
            "tangents": {"left": left, "right": right, "bottom": bottom, "top": top},
            "position_in_device_m": view.source.position_in_device.tolist(),
            "device_from_camera": view.source.device_from_camera.tolist(),
        },
        "convention": list(form.convention),
        "loses": [asdict(loss) for loss in losses(view, form.carries, judged)],
    }


def _borders(view: ExportedView) -> tuple[list[float], list[float]]:
    camera = view.source.camera
    return np.asarray(camera.tangent_min).tolist(), np.asarray(camera.tangent_max).tolist()


def _depth_number(depth_m: float) -> float | str:
    """A depth in metres, or "infinity", which JSON has no number for."""
    return depth_m if math.isfinite(depth_m) else "infinity"


def header_texts(record: dict[str, Any]) -> dict[str, str]:
    """Facts as the texts of a header."""
    return {key: value if isinstance(value, str) else json.dumps(value) for key, value in record.items()}


def write_facts(path: Path, record: dict[str, Any]) -> Path:
    """Write facts as JSON beside a file whose format has no header."""
    return write_text(path, json.dumps(record, indent=1) + "\n")
