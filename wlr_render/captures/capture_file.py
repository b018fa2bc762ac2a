"""Capture files: the `ObservationTable` of one eye as one .npz.

The archive holds `header`, a JSON text with

    format "wlr-captures", version 2, frame "openxr", units {"length": "m", "sigma": "arcmin", "pixel": "px"},
    device, eye, panel {width_px, height_px} or null, eye_box {centre_m, size_m}, see_through_eye_box or null

and one array for each column of the table and of its conditions. Conditions that no row has recorded are omitted.
Priors of the camera's motion are optional: `display_motion_capture`, `display_motion_size`, `display_motion_log_sigma`,
and the same of `see_through_motion`, see `CaptureMotionPrior`.
Version 1, which is still read, has one array per attribute of `captures.correspondences`, named `display_viewpoint`,
..., `see_through_point`, ..., and no conditions.
"""

import json
import zipfile
import zlib
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wlr_render.captures.correspondences import (
    CaptureMotionPrior,
    Conditions,
    DisplayCaptures,
    EyeCaptures,
    SeeThroughCaptures,
)
from wlr_render.captures.observation_table import COLUMNS, MOTIONS, ObservationTable, observation_table
from wlr_render.errors import BadInputError
from wlr_render.files import write_arrays
from wlr_render.mappings import EyeBox, Panel
from wlr_render.toml_files import Table

FORMAT = "wlr-captures"
VERSION = 2
_UNITS = {"length": "m", "sigma": "arcmin", "pixel": "px"}
_CONDITIONS = tuple(each.name for each in fields(Conditions))
_MOTION = tuple(each.name for each in fields(CaptureMotionPrior))


def save_captures(path: str | Path, captures: EyeCaptures | ObservationTable) -> Path:
    """Write a capture file whole or not at all; the name must end in .npz."""
    if Path(path).suffix != ".npz":
        raise BadInputError(f"{path}: a capture file must be named *.npz.")
    table = captures
    if isinstance(table, EyeCaptures):
        table = observation_table(table.display, table.see_through)
    box, panel = table.see_through_eye_box, table.panel
    header = {
        "format": FORMAT,
        "version": VERSION,
        "frame": "openxr",
        "units": _UNITS,
        "device": table.device,
        "eye": table.eye,
        "panel": None if panel is None else {"width_px": panel.width_px, "height_px": panel.height_px},
        "eye_box": _box_record(table.eye_box),
        "see_through_eye_box": None if box is None else _box_record(box),
    }
    conditions = {name: getattr(table.conditions, name) for name in _CONDITIONS}
    recorded = {name: values for name, values in conditions.items() if _is_recorded(values)}
    columns = {name: getattr(table, name) for name in COLUMNS}
    motions = {
        f"{name}_{part}": np.asarray(getattr(motion, part))
        for name in MOTIONS
        if (motion := getattr(table, name)) is not None
        for part in _MOTION
    }
    return write_arrays(path, {"header": np.array(json.dumps(header))} | columns | recorded | motions)


def load_captures(path: str | Path) -> EyeCaptures:
    """Read what a fit takes from a capture file: the panel in one colour, and see-through.

    Raises:
        BadInputError: as `load_observations`.
    """
    return load_observations(path).captures()


def load_observations(path: str | Path) -> ObservationTable:
    """Read a capture file.

    Raises:
        BadInputError: the file cannot be read, is cut short, is something else, or is of another version.
    """
    arrays = _read_archive(Path(path))
    header = _header(arrays, path)
    panel = header.table("panel") if header.has("panel") else None
    common: dict[str, Any] = {
        "device": header.text("device"),
        "eye": header.text("eye"),
        "panel": None if panel is None else Panel(panel.whole("width_px", 1), panel.whole("height_px", 1)),
        "eye_box": _box(header.table("eye_box")),
    }
    box = _box(header.table("see_through_eye_box")) if header.has("see_through_eye_box") else None
    try:
        if header.whole("version", 1) == 1:
            return _of_version_1(arrays, common, box, path)
        count = len(_array(arrays, "kind", path))
        recorded: dict[str, Any] = {name: arrays[name] for name in _CONDITIONS if name in arrays}
        columns: dict[str, Any] = {name: _array(arrays, name, path) for name in COLUMNS}
        conditions = Conditions.recorded(count, **recorded)
        for name in MOTIONS:
            if f"{name}_size" in arrays:
                motion: dict[str, Any] = {part: _array(arrays, f"{name}_{part}", path) for part in _MOTION}
                columns[name] = CaptureMotionPrior(**motion)
        return ObservationTable(**common, see_through_eye_box=box, conditions=conditions, **columns)
    except BadInputError as error:
        raise _named(path, error) from error


def _of_version_1(
    arrays: dict[str, NDArray[Any]], common: dict[str, Any], box: EyeBox | None, path: str | Path
) -> ObservationTable:
    rows = ("viewpoint", "view_dir", "capture", "sigma_arcmin")
    display: dict[str, Any] = {name: _array(arrays, f"display_{name}", path) for name in (*rows, "pixel")}
    if "see_through_viewpoint" not in arrays or box is None:
        return observation_table(DisplayCaptures(**common, **display), None)
    see_through: dict[str, Any] = {
        name: _array(arrays, f"see_through_{name}", path) for name in (*rows, "point", "target_pose")
    }
    eye = {name: common[name] for name in ("device", "eye")}
    return observation_table(
        DisplayCaptures(**common, **display), SeeThroughCaptures(**eye, eye_box=box, **see_through)
    )


def _named(path: str | Path, error: BadInputError) -> BadInputError:
    """The error with the name of the file."""
    return error if str(path) in str(error) else BadInputError(f"{path}: {error}")


def _is_recorded(values: NDArray[Any]) -> bool:
    return bool(np.any(values >= 0) if np.issubdtype(values.dtype, np.integer) else np.isfinite(values).any())


def _box_record(box: EyeBox) -> dict[str, list[float]]:
    return {"centre_m": box.centre.tolist(), "size_m": box.size.tolist()}


def _box(table: Table) -> EyeBox:
    return EyeBox(table.vector("centre_m", 3), table.vector("size_m", 3))


def _array(arrays: dict[str, NDArray[Any]], name: str, path: str | Path) -> NDArray[Any]:
    if name not in arrays:
        raise BadInputError(f"{path}: the array '{name}' is missing; write the file again.")
    return arrays[name]


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
    if content.get("version") not in (1, VERSION):
        found = content.get("version")
        raise BadInputError(
            f"{path}: has version {found}; this program reads versions 1 and {VERSION}: write it again."
        )
    if content.get("frame") != "openxr" or content.get("units") != _UNITS:
        raise BadInputError(f"{path}: must be in frame 'openxr' with units {_UNITS}; convert it.")
    return Table({key: value for key, value in content.items() if value is not None}, str(path))
