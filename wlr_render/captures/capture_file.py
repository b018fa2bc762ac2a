"""Capture files: the captures of one eye as one .npz.

The archive holds `header`, a JSON text (docs/files.md has one to copy), and one array for each column of the captures,
with the rows of the panel and of real points in one table. Columns that no row has recorded may be left out.
Priors of the camera's motion are optional: `display_motion_capture`, `display_motion_size`, `display_motion_log_sigma`,
and the same of `see_through_motion`, see `CaptureMotionPrior`. So are errors that all captures share: `common_sources`
in the header, and the arrays `display_common_capture`, `..._motion`, `..._target_pose`, `..._target`, `..._focus`,
`..._lens_orders`, `..._lens_low`, `..._lens_high` and `..._lens_coefficients`, and the same of `see_through_common`;
see `CommonErrors`. Those of an exact lens, or without target poses, are omitted. Version 1 is still read.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wlr_render.captures.capture_checks import check_plausible
from wlr_render.captures.capture_writer import (
    FORMAT,
    LENS,
    MOTION,
    OF_TARGETS,
    OPTIONAL,
    ROWS,
    UNITS,
    VERSION,
    file_columns,
)
from wlr_render.captures.correspondences import Captures, DisplayCaptures, SeeThroughCaptures
from wlr_render.captures.feature_captures import (
    PANEL_PIXEL,
    REAL_POINT,
    CaptureMotionPrior,
    CommonErrors,
    FeatureCaptures,
    column_of,
    rows_of,
)
from wlr_render.errors import BadInputError
from wlr_render.io.file_records import read_part
from wlr_render.io.input_files import LIMITS, prefix_errors, read_arrays
from wlr_render.io.toml_files import Table, parse_json
from wlr_render.mappings import EyeBox, Panel
from wlr_render.numerics.polynomial import HIGHEST_ORDER, Box, Polynomial

_SIDES = ("display", "see_through")
_OF_VERSION_1 = ("viewpoint", "view_dir", "capture", "sigma_arcmin")
_Sides = dict[str, dict[str, Any]]
_BOXES = ("eye_box", "see_through_eye_box")
_MOST_COLUMNS = 16  # most numbers of a row: axes of a stage, the widest column


def load_captures(path: str | Path) -> Captures:
    """Read a capture file for fitting: display captures in one colour, and see-through captures.

    Raises:
        BadInputError: as `load_observations`.
    """
    return load_observations(path).in_colour()


def load_observations(path: str | Path) -> Captures:
    """Read a capture file.

    Raises:
        BadInputError: the file cannot be read, is cut short, has another format or version, or holds implausible
            values.
    """
    with prefix_errors(path):
        arrays = _Arrays(read_arrays(path, "a capture file (.npz)"))
        header = _header(arrays, path)
        _check_sizes(arrays)
        boxes = {
            name: read_part(EyeBox, header.table(name)) for name in _BOXES if name == "eye_box" or header.has(name)
        }
        columns = {} if header.whole("version", 1) == 1 else _columns(arrays)
        captures = _captures(header, boxes, _sides(columns) if columns else _sides_of_version_1(arrays), arrays)
        check_plausible(captures, columns or file_columns(captures.parts), boxes)
    return captures


class _Arrays(dict[str, NDArray[Any]]):
    """Arrays of a file by name; a missing name raises `BadInputError`."""

    def __missing__(self, name: str) -> NDArray[Any]:
        raise BadInputError(f"the array '{name}' is missing; write the file again.")


def _columns(arrays: _Arrays) -> dict[str, NDArray[Any]]:
    """Return the columns that a file has, all with the same number of rows."""
    kind = arrays["kind"]
    count = np.size(kind)
    if not count:
        raise BadInputError("the table is empty; write at least one reading.")
    if not np.isin(rows_of("kind", kind, (count,)), (PANEL_PIXEL, REAL_POINT)).all():
        raise BadInputError(f"captures: 'kind' must be {PANEL_PIXEL} (panel pixel) or {REAL_POINT} (real point).")
    columns = {"kind": kind, "feature": rows_of("feature", arrays["feature"], (count, 3), finite=False)}
    for name in ROWS:
        if name not in OPTIONAL or name in arrays:
            columns[name] = column_of(FeatureCaptures, name, arrays[name], count)
    return columns


def _sides(columns: Mapping[str, NDArray[Any]]) -> _Sides:
    """Return the columns of the captures of each side in a file."""
    rows, feature = columns["kind"] == PANEL_PIXEL, columns["feature"]
    of_all = {name: values for name, values in columns.items() if name in ROWS}
    display = {name: values[rows] for name, values in of_all.items() if not name.startswith("target")}
    see_through = {name: values[~rows] for name, values in of_all.items()}
    sides = {"display": display | {"pixel": feature[rows, :2]}, "see_through": see_through | {"point": feature[~rows]}}
    return {side: of_side for side, of_side in sides.items() if len(of_side["capture"])}


def _sides_of_version_1(arrays: _Arrays) -> _Sides:
    """Return the columns of the captures of each side in a file of version 1, which has one table for each side."""
    names = {"display": ["pixel"], "see_through": ["point", "target_pose"]}
    return {
        side: {name: arrays[f"{side}_{name}"] for name in (*_OF_VERSION_1, *names[side])}
        for side in _SIDES
        if side == "display" or f"{side}_viewpoint" in arrays
    }


def _captures(
    header: Table,
    boxes: Mapping[str, EyeBox],
    sides: _Sides,
    arrays: _Arrays,
) -> Captures:
    """Return captures from the columns of each side, the header and the arrays of motions and common errors."""
    eye: dict[str, Any] = {"device": header.text("device"), "eye": header.text("eye")}
    panel = read_part(Panel, header.table("panel")) if header.has("panel") else None
    sources = tuple(header.texts("common_sources")) if header.has("common_sources") else ()
    bench = {side: _bench(arrays, side, sources) for side in _SIDES}
    display = see_through = None
    if "display" in sides:
        if panel is None:
            raise BadInputError("captures: there are panel pixels, but no 'panel'; state it.")
        display = DisplayCaptures(**eye, eye_box=boxes["eye_box"], panel=panel, **sides["display"], **bench["display"])
    if "see_through" in sides:
        if "see_through_eye_box" not in boxes:
            raise BadInputError("captures: there are real points, but no 'see_through_eye_box'; state it.")
        box = boxes["see_through_eye_box"]
        see_through = SeeThroughCaptures(**eye, eye_box=box, **sides["see_through"], **bench["see_through"])
    return Captures(display, see_through, panel)


def _bench(arrays: _Arrays, side: str, sources: tuple[str, ...]) -> dict[str, Any]:
    """Return the prior of motions and the common errors of a side; missing ones are left out."""
    known: dict[str, Any] = {}
    if any(f"{side}_motion_{part}" in arrays for part in MOTION):
        motion: dict[str, Any] = {part: arrays[f"{side}_motion_{part}"] for part in MOTION}
        known["motion"] = CaptureMotionPrior(**motion)
    if sources and f"{side}_common_motion" in arrays:
        known["common"] = _common(arrays, f"{side}_common", sources)
    return known


def _common(arrays: _Arrays, name: str, sources: tuple[str, ...]) -> CommonErrors:
    lens = None
    if f"{name}_lens_coefficients" in arrays:
        orders, low, high, coefficients = (arrays[f"{name}_{part}"] for part in LENS)
        shapes, terms = (orders.shape, low.shape, high.shape, coefficients.shape), len(np.atleast_1d(coefficients))
        if shapes != ((terms, 2), (2,), (2,), (terms, 2 * len(sources))):
            raise BadInputError(f"'{name}_lens_...' have shapes that do not fit; write the file again.")
        if orders.dtype.kind not in "iu" or orders.min(initial=0) < 0 or orders.max(initial=0) > HIGHEST_ORDER:
            raise BadInputError(f"'{name}_lens_orders' must be whole numbers from 0 to {HIGHEST_ORDER}.")
        if not (np.isfinite([low, high]).all() and np.all(low < high) and np.isfinite(coefficients).all()):
            raise BadInputError(f"'{name}_lens_...' must be finite, with 'low' below 'high'; correct them.")
        lens = Polynomial(orders.astype(np.int64), Box(low, high), np.asarray(coefficients, np.float64))
    given: dict[str, Any] = {part: arrays[f"{name}_{part}"] for part in ("capture", "motion")}
    if f"{name}_target_pose" in arrays:
        given |= {part: arrays[f"{name}_{part}"] for part in OF_TARGETS}
    return CommonErrors(sources, **given, lens=lens)


def _check_sizes(arrays: _Arrays) -> None:
    """Refuse arrays that are not numeric or have too many rows, before any array is converted."""
    for name, values in arrays.items():
        if name != "header" and values.dtype.kind not in "iuf":
            raise BadInputError(f"'{name}' holds {values.dtype} values, not numbers; write the file again.")
        if len(np.atleast_1d(values)) > LIMITS.rows or values.size > _MOST_COLUMNS * LIMITS.rows:
            raise BadInputError(
                f"'{name}' has the shape {values.shape}; at most {LIMITS.rows} rows of {_MOST_COLUMNS} numbers "
                "are read: leave some out."
            )
        if name == "stage" and values.ndim and values.shape[-1] > _MOST_COLUMNS:
            raise BadInputError(
                f"'stage' has {values.shape[-1]} axes; a stage has at most {_MOST_COLUMNS}: leave some out."
            )


def _header(arrays: _Arrays, path: str | Path) -> Table:
    text = str(arrays["header"])
    content = parse_json(path, text, "a capture file with a JSON 'header'", "write it again")
    header = Table({key: value for key, value in content.items() if value is not None}, str(path))
    header.check_head(FORMAT, VERSION, oldest=1)
    if content.get("frame") != "openxr" or content.get("units") != UNITS:
        raise BadInputError(f"{path}: must be in frame 'openxr' with units {UNITS}; convert it.")
    return header
