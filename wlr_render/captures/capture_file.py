"""Capture files: one eye's `EyeCaptures` as one .npz.

The archive holds `header`, a JSON text with

    format "wlr-captures", version 1, frame "openxr", units {"length": "m", "sigma": "arcmin", "pixel": "px"},
    device, eye, panel {width_px, height_px}, eye_box {centre_m, size_m}, see_through_eye_box or null

and one array per attribute, named `display_viewpoint`, `display_pixel`, ..., `see_through_point`, ... as in
`captures.correspondences`.
"""

import json
import zipfile
import zlib
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wlr_render.captures.correspondences import DisplayCaptures, EyeCaptures, SeeThroughCaptures
from wlr_render.errors import BadInputError
from wlr_render.files import write_arrays
from wlr_render.mappings import EyeBox, Panel
from wlr_render.toml_files import Table

FORMAT = "wlr-captures"
VERSION = 1
_UNITS = {"length": "m", "sigma": "arcmin", "pixel": "px"}


def save_captures(path: str | Path, captures: EyeCaptures) -> Path:
    """Write a capture file whole or not at all; the name must end in .npz."""
    if Path(path).suffix != ".npz":
        raise BadInputError(f"{path}: a capture file must be named *.npz.")
    display, see_through = captures.display, captures.see_through
    header = {
        "format": FORMAT,
        "version": VERSION,
        "frame": "openxr",
        "units": _UNITS,
        "device": display.device,
        "eye": display.eye,
        "panel": {"width_px": display.panel.width_px, "height_px": display.panel.height_px},
        "eye_box": _box_record(display.eye_box),
        "see_through_eye_box": None if see_through is None else _box_record(see_through.eye_box),
    }
    arrays = {"header": np.array(json.dumps(header))} | _arrays("display", display)
    if see_through is not None:
        arrays |= _arrays("see_through", see_through)
    return write_arrays(path, arrays)


def load_captures(path: str | Path) -> EyeCaptures:
    """Read a capture file.

    Raises:
        BadInputError: the file cannot be read, is cut short, is something else, or is of another version.
    """
    arrays = _read_archive(Path(path))
    header = _header(arrays, path)
    panel = header.table("panel")
    common = {"device": header.text("device"), "eye": header.text("eye")}
    display_parts = _parts("display", DisplayCaptures, arrays, path) | common
    display_parts["panel"] = Panel(panel.whole("width_px", 1), panel.whole("height_px", 1))
    display_parts["eye_box"] = _box(header.table("eye_box"))
    try:
        display = DisplayCaptures(**display_parts)
        if "see_through_viewpoint" not in arrays:
            return EyeCaptures(display)
        see_through_parts = _parts("see_through", SeeThroughCaptures, arrays, path) | common
        see_through_parts["eye_box"] = _box(header.table("see_through_eye_box"))
        return EyeCaptures(display, SeeThroughCaptures(**see_through_parts))
    except BadInputError as error:
        raise error if str(path) in str(error) else BadInputError(f"{path}: {error}") from error


def _box_record(box: EyeBox) -> dict[str, list[float]]:
    return {"centre_m": box.centre.tolist(), "size_m": box.size.tolist()}


def _box(table: Table) -> EyeBox:
    return EyeBox(table.vector("centre_m", 3), table.vector("size_m", 3))


def _array_names(kind: type) -> list[str]:
    return [f.name for f in fields(kind) if f.name not in ("device", "eye", "eye_box", "panel")]


def _arrays(prefix: str, captures: DisplayCaptures | SeeThroughCaptures) -> dict[str, Any]:
    return {f"{prefix}_{name}": getattr(captures, name) for name in _array_names(type(captures))}


def _parts(prefix: str, kind: type, arrays: dict[str, NDArray[Any]], path: str | Path) -> dict[str, Any]:
    parts = {}
    for name in _array_names(kind):
        if f"{prefix}_{name}" not in arrays:
            raise BadInputError(f"{path}: the array '{prefix}_{name}' is missing; write the file again.")
        parts[name] = arrays[f"{prefix}_{name}"]
    return parts


def _read_archive(path: Path) -> dict[str, NDArray[Any]]:
    try:
        with zipfile.ZipFile(path), np.load(path, allow_pickle=False) as archive:
            return {name: archive[name] for name in archive.files}
    except OSError as error:
        raise BadInputError(f"{path}: cannot be read ({error.strerror or error}).") from error
    except (zipfile.BadZipFile, zlib.error, EOFError, ValueError, KeyError) as error:
        raise BadInputError(f"{path}: is cut short or is not a capture file (.npz); write it again.") from error


def _header(arrays: dict[str, NDArray[Any]], path: str | Path) -> Table:
    try:
        content = json.loads(str(arrays["header"]))
    except (KeyError, json.JSONDecodeError) as error:
        raise BadInputError(f"{path}: is an .npz without the header of a capture file.") from error
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise BadInputError(f"{path}: is not a capture file (its header does not say format '{FORMAT}').")
    if content.get("version") != VERSION:
        found = content.get("version")
        raise BadInputError(f"{path}: has version {found}; this program reads version {VERSION}: write it again.")
    if content.get("frame") != "openxr" or content.get("units") != _UNITS:
        raise BadInputError(f"{path}: must be in frame 'openxr' with units {_UNITS}; convert it.")
    return Table(content, str(path))
