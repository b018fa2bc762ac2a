"""Writing of capture files; `capture_file.py` has the format and reads them."""

import json
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wlr_render.captures.feature_captures import (
    REAL_POINT,
    CaptureMotionPrior,
    CommonErrors,
    FeatureCaptures,
    columns_of,
)
from wlr_render.errors import BadInputError
from wlr_render.io.atomic_files import write_arrays
from wlr_render.io.file_records import record_keys
from wlr_render.mappings import Panel

FORMAT = "wlr-captures"
VERSION = 2
UNITS = {"length": "m", "sigma": "arcmin", "pixel": "px"}
ROWS = columns_of(FeatureCaptures)
OPTIONAL = ROWS[ROWS.index("visit") :]
MOTION = tuple(each.name for each in fields(CaptureMotionPrior))
LENS = ("lens_orders", "lens_low", "lens_high", "lens_coefficients")
OF_TARGETS = ("target_pose", "target", "focus")
_FIRST = 2  # columns before `feature` in a file


def write_captures(path: str | Path, parts: Sequence[FeatureCaptures], panel: Panel | None) -> Path:
    """Write the captures of one eye, one part or both; see `Captures.save`."""
    if Path(path).suffix != ".npz":
        raise BadInputError(f"{path}: a capture file must be named *.npz.")
    source = parts[0]
    see_through_eye_box = next((record_keys(part.eye_box) for part in parts if part.kind == REAL_POINT), None)
    header: dict[str, Any] = {
        "format": FORMAT,
        "version": VERSION,
        "frame": "openxr",
        "units": UNITS,
        "device": source.device,
        "eye": source.eye,
        "panel": None if panel is None else record_keys(panel),
        "eye_box": record_keys(source.eye_box),
        "see_through_eye_box": see_through_eye_box,
    }
    columns = file_columns(parts)
    arrays = {name: values for name, values in columns.items() if name not in OPTIONAL or _is_recorded(values)}
    sides = {part.side.replace("-", "_"): part for part in parts}
    for name, side in sides.items():
        if side.motion is not None:
            arrays |= {f"{name}_motion_{part}": np.asarray(getattr(side.motion, part)) for part in MOTION}
    for name, side in sides.items():
        if side.common is not None:
            header["common_sources"] = side.common.sources
            arrays |= {f"{name}_common_{part}": values for part, values in _common_arrays(side.common)}
    return write_arrays(path, {"header": np.array(json.dumps(header))} | arrays)


def file_columns(parts: Sequence[FeatureCaptures]) -> dict[str, NDArray[Any]]:
    """Return the columns of a file by name, with the rows of `parts` in order."""
    kinds = [np.full(len(part), part.kind) for part in parts]
    names = (*ROWS[:_FIRST], "feature", *ROWS[_FIRST:])
    columns = {name: joined_column(name, [getattr(part, name) for part in parts]) for name in names}
    return {"kind": np.concatenate(kinds)} | columns


def joined_column(name: str, parts: Sequence[NDArray[Any]]) -> NDArray[Any]:
    """Return the parts of a column as one; stages with fewer axes are filled with NaN."""
    if name == "stage":
        width = max(part.shape[1] for part in parts)
        parts = [np.pad(part, ((0, 0), (0, width - part.shape[1])), constant_values=np.nan) for part in parts]
    return np.concatenate(parts)


def _common_arrays(common: CommonErrors) -> list[tuple[str, NDArray[Any]]]:
    """Return the arrays of common errors by their names in a file."""
    arrays: list[tuple[str, NDArray[Any]]] = [("capture", common.capture), ("motion", common.motion)]
    if len(common.target_pose):
        arrays += [(name, getattr(common, name)) for name in OF_TARGETS]
    if (lens := common.lens) is not None:
        arrays += zip(LENS, (lens.orders, lens.box.low, lens.box.high, lens.coefficients), strict=True)
    return arrays


def _is_recorded(values: NDArray[Any]) -> bool:
    return bool(np.any(values >= 0) if np.issubdtype(values.dtype, np.integer) else np.isfinite(values).any())
