"""What a receiver must know about a map: from which headset, eye and pupil, for which camera, and what it loses."""

import json
import math
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from wlr_render.exports.format import Format
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


def losses(view: ExportedView, has_every_depth: bool) -> list[Loss]:
    """What a map of this view loses at `JUDGED_DEPTH_M`, and with the pupil `PUPIL_SHIFT_M` to any side.

    Directions are those from the source camera to the points that the panel's pixels show and should show. The pupil
    moves right, left, up and down in the device as far as the eye box allows; the errors are of all these together.
    """
    colour = view.middle_colour
    pixel = view.mappings(colour).display.panel.grid(_JUDGED_PIXELS, _JUDGED_PIXELS)
    made_for = np.moveaxis(view.rays_at(colour, pixel), -1, 0)
    found = []
    if not has_every_depth:
        found.append(_loss(f"points at {JUDGED_DEPTH_M:g} m", [_arcmin(view, made_for, made_for, JUDGED_DEPTH_M)]))
    box = view.mappings(colour).eye_box
    steps = PUPIL_SHIFT_M * np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]])
    moved = [view.viewpoint + step for step in steps if box.contains(view.viewpoint + step)]
    errors = [
        _arcmin(view, made_for, np.moveaxis(view.rays_at(colour, pixel, pupil), -1, 0), view.depth_m) for pupil in moved
    ]
    found.append(_loss(f"pupil {1e3 * PUPIL_SHIFT_M:g} mm aside", errors))
    return found


def _arcmin(view: ExportedView, shown: FloatArray, due: FloatArray, depth_m: float) -> FloatArray:
    """Angles between what pixels show, by a map for `view.depth_m`, and what they should, at `depth_m`."""
    due_tangents = np.moveaxis(due[:2] + due[2:] / depth_m, 0, -1)
    return arcmin_between(dir_of_tangents(view.tangents(shown)), dir_of_tangents(due_tangents))


def _loss(case: str, errors: list[FloatArray]) -> Loss:
    values = np.concatenate([each.ravel() for each in errors]) if errors else np.empty(0)
    values = values[np.isfinite(values)]
    if not values.size:
        return Loss(case, None, None)
    return Loss(case, float(np.sqrt(np.mean(values**2))), float(values.max()))


def facts(view: ExportedView, colour: str, form: Format) -> dict[str, Any]:
    """All that a receiver must know about one map, as plain JSON."""
    camera, (left, bottom), (right, top) = view.source.camera, *_borders(view)
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
        "depth_m": "every" if form.carries.every_depth else depth_text(view.depth_m),
        "panel_size_px": list(view.panel_size_px),
        "source_camera": {
            "size_px": list(camera.size_px),
            "tangents": {"left": left, "right": right, "bottom": bottom, "top": top},
            "position_in_device_m": view.source.position_in_device.tolist(),
            "device_from_camera": view.source.device_from_camera.tolist(),
        },
        "convention": list(form.convention),
        "loses": [asdict(loss) for loss in losses(view, form.carries.every_depth)],
    }


def _borders(view: ExportedView) -> tuple[list[float], list[float]]:
    camera = view.source.camera
    return np.asarray(camera.tangent_min).tolist(), np.asarray(camera.tangent_max).tolist()


def depth_text(depth_m: float) -> float | str:
    """A depth in metres, or "infinity", which JSON has no number for."""
    return depth_m if math.isfinite(depth_m) else "infinity"


def header_texts(record: dict[str, Any]) -> dict[str, str]:
    """Facts as the texts of a header."""
    return {key: value if isinstance(value, str) else json.dumps(value) for key, value in record.items()}


def write_facts(path: Path, record: dict[str, Any]) -> Path:
    """Write facts as JSON beside a file whose format has no header."""
    return write_text(path, json.dumps(record, indent=1) + "\n")
