"""Capture files: the `ObservationTable` of one eye as one .npz.

The archive holds `header`, a JSON text (docs/files.md has one to copy), and one array for each column of the table and
of its conditions. Conditions that no row has recorded are omitted.
Priors of the camera's motion are optional: `display_motion_capture`, `display_motion_size`, `display_motion_log_sigma`,
and the same of `see_through_motion`, see `CaptureMotionPrior`. So are errors that all captures share: `common_sources`
in the header, and the arrays `display_common_capture`, `..._motion`, `..._target_pose`, `..._target`, `..._focus`,
`..._lens_orders`, `..._lens_low`, `..._lens_high` and `..._lens_coefficients`, and the same of `see_through_common`;
see `CommonErrors`. Those of an exact lens, or without target poses, are omitted. Version 1 is still read.
"""

import json
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wlr_render.atomic_files import write_arrays
from wlr_render.captures.correspondences import (
    CaptureMotionPrior,
    Captures,
    CommonErrors,
    Conditions,
    DisplayCaptures,
    SeeThroughCaptures,
)
from wlr_render.captures.observation_table import (
    COLUMNS,
    COMMONS,
    MOTIONS,
    PANEL_PIXEL,
    REAL_POINT,
    ObservationTable,
    observation_table,
)
from wlr_render.errors import BadInputError
from wlr_render.input_files import LIMITS, prefix_errors, read_arrays, require_eye_box, require_length, require_pixels
from wlr_render.mappings import EyeBox, Panel
from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.polynomial import HIGHEST_ORDER, Box, Polynomial
from wlr_render.toml_files import Table, parse_json

FORMAT = "wlr-captures"
VERSION = 2
_UNITS = {"length": "m", "sigma": "arcmin", "pixel": "px"}
_CONDITIONS = tuple(each.name for each in fields(Conditions))
_MOTION = tuple(each.name for each in fields(CaptureMotionPrior))
_LENS = ("lens_orders", "lens_low", "lens_high", "lens_coefficients")
_OF_TARGETS = ("target_pose", "target", "focus")

_DEVICE_M, _WORLD_M = 10.0, 100.0  # largest distance within the device, and of real points
_SIGMA_ARCMIN = 600.0  # largest sigma: ten degrees
_NEAREST_M = 0.03  # least distance of real points from the eye: nearer ones are in kilometres
_LEAST_SIGMA_ARCMIN = 1e-6  # least sigma: 0.06 milliarcseconds
_SIGMAS_DIFFER = 1e4  # largest ratio of sigmas; a row of smaller sigma alone would decide the fit
_PANEL_MARGIN = (2.0, 0.02)  # margin outside the panel for noise: pixels, and share of the panel's side
_MOST_OUTSIDE = 0.05  # largest share of panel pixels outside the margin: more belong to another panel
_ONE_PLACE_M = 5e-3  # largest error of a stage that returns to a position
_BOX_OF_PLACES = 1e-2  # least size of an eye box relative to the range of camera positions
_SMALL_PART = 0.2  # least share of the eye box that positions span: less looks like a wrong unit
_MOST_COLUMNS = 16
_PLAUSIBLE = {
    "visit": (-1, LIMITS.index),
    "channel": (-1, 2),
    "temperature_c": LIMITS.temperature_c,
    "travel": (-1, 1),
    "stage": (-10, 10),
    "time_s": (-LIMITS.time_s, LIMITS.time_s),
}
"""Ranges of conditions: metres or radians of the stage."""


def save_captures(path: str | Path, captures: Captures | ObservationTable) -> Path:
    """Write a capture file atomically; the name must end in .npz."""
    if Path(path).suffix != ".npz":
        raise BadInputError(f"{path}: a capture file must be named *.npz.")
    table = captures
    if isinstance(table, Captures):
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
    commons = {name: common for name in COMMONS if (common := getattr(table, name)) is not None}
    if commons:
        header["common_sources"] = next(iter(commons.values())).sources
    shared = {f"{name}_{part}": values for name, each in commons.items() for part, values in _common_arrays(each)}
    return write_arrays(path, {"header": np.array(json.dumps(header))} | columns | recorded | motions | shared)


def load_captures(path: str | Path) -> Captures:
    """Read a capture file for fitting: display captures in one colour, and see-through captures.

    Raises:
        BadInputError: as `load_observations`.
    """
    return load_observations(path).captures()


def load_observations(path: str | Path) -> ObservationTable:
    """Read a capture file.

    Raises:
        BadInputError: the file cannot be read, is cut short, has another format or version, or holds implausible
            values.
    """
    arrays = read_arrays(path, "a capture file (.npz)")
    header = _header(arrays, path)
    _check_sizes(path, arrays)
    with prefix_errors(path):
        table = _table(header, arrays, path)
    _check_plausible(path, table)
    return table


def place_warnings(captures: Captures) -> list[str]:
    """Warn if the camera positions span little of the eye box, as with a unit that is off by ten."""
    warnings = []
    for name, side in (("display", captures.display), ("see-through", captures.see_through)):
        if side is None or len(np.unique(side.capture)) < 2:
            continue
        span, box = (1e3 * each.max() for each in (np.ptp(side.viewpoint, axis=0), side.eye_box.size))
        if span < _SMALL_PART * box:
            warnings.append(
                f"The camera places of the {name} captures span {span:.2g} mm of an eye box of {box:.2g} mm: are the "
                "viewpoints or the eye box in another unit than metres? The models extrapolate beyond the places."
            )
    return warnings


def _table(header: Table, arrays: dict[str, NDArray[Any]], path: str | Path) -> ObservationTable:
    panel = header.table("panel") if header.has("panel") else None
    common: dict[str, Any] = {
        "device": header.text("device"),
        "eye": header.text("eye"),
        "panel": None if panel is None else Panel(panel.whole("width_px", 1), panel.whole("height_px", 1)),
        "eye_box": _box(header.table("eye_box")),
    }
    box = _box(header.table("see_through_eye_box")) if header.has("see_through_eye_box") else None
    if header.whole("version", 1) == 1:
        return _of_version_1(arrays, common, box, path)
    count = np.size(_array(arrays, "kind", path))
    recorded: dict[str, Any] = {name: arrays[name] for name in _CONDITIONS if name in arrays}
    columns: dict[str, Any] = {name: _array(arrays, name, path) for name in COLUMNS}
    conditions = Conditions.recorded(count, **recorded)
    for name in MOTIONS:
        if any(f"{name}_{part}" in arrays for part in _MOTION):
            motion: dict[str, Any] = {part: _array(arrays, f"{name}_{part}", path) for part in _MOTION}
            columns[name] = CaptureMotionPrior(**motion)
    if header.has("common_sources"):
        sources = tuple(header.texts("common_sources"))
        columns |= {name: _common(arrays, name, sources, path) for name in COMMONS if f"{name}_motion" in arrays}
    return ObservationTable(**common, see_through_eye_box=box, conditions=conditions, **columns)


def _common_arrays(common: CommonErrors) -> list[tuple[str, NDArray[Any]]]:
    """Return the arrays of common errors by their names in a file."""
    arrays: list[tuple[str, NDArray[Any]]] = [("capture", common.capture), ("motion", common.motion)]
    if len(common.target_pose):
        arrays += [(name, getattr(common, name)) for name in _OF_TARGETS]
    if (lens := common.lens) is not None:
        arrays += zip(_LENS, (lens.orders, lens.box.low, lens.box.high, lens.coefficients), strict=True)
    return arrays


def _common(arrays: dict[str, NDArray[Any]], name: str, sources: tuple[str, ...], path: str | Path) -> CommonErrors:
    lens = None
    if f"{name}_lens_coefficients" in arrays:
        orders, low, high, coefficients = (_array(arrays, f"{name}_{part}", path) for part in _LENS)
        shapes = (orders.shape, low.shape, high.shape, coefficients.shape)
        if shapes != ((len(coefficients), 2), (2,), (2,), (len(coefficients), 2 * len(sources))):
            raise BadInputError(f"{path}: '{name}_lens_...' have shapes that do not fit; write the file again.")
        if orders.dtype.kind not in "iu" or orders.min(initial=0) < 0 or orders.max(initial=0) > HIGHEST_ORDER:
            raise BadInputError(f"{path}: '{name}_lens_orders' must be whole numbers from 0 to {HIGHEST_ORDER}.")
        if not (np.isfinite([low, high]).all() and np.all(low < high) and np.isfinite(coefficients).all()):
            raise BadInputError(f"{path}: '{name}_lens_...' must be finite, with 'low' below 'high'; correct them.")
        lens = Polynomial(orders.astype(np.int64), Box(low, high), np.asarray(coefficients, np.float64))
    given: dict[str, Any] = {part: _array(arrays, f"{name}_{part}", path) for part in ("capture", "motion")}
    if f"{name}_target_pose" in arrays:
        given |= {part: _array(arrays, f"{name}_{part}", path) for part in _OF_TARGETS}
    return CommonErrors(sources, **given, lens=lens)


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


def _check_sizes(path: str | Path, arrays: dict[str, NDArray[Any]]) -> None:
    """Refuse arrays of anything but numbers, and too many rows, before any of them is converted."""
    for name, values in arrays.items():
        if name != "header" and values.dtype.kind not in "iuf":
            raise BadInputError(f"{path}: '{name}' holds {values.dtype} values, not numbers; write the file again.")
        if len(np.atleast_1d(values)) > LIMITS.rows or values.size > _MOST_COLUMNS * LIMITS.rows:
            raise BadInputError(
                f"{path}: '{name}' has the shape {values.shape}; at most {LIMITS.rows} rows of {_MOST_COLUMNS} numbers "
                "are read: leave some out."
            )
        if name == "stage" and values.ndim and values.shape[-1] > _MOST_COLUMNS:
            raise BadInputError(
                f"{path}: 'stage' has {values.shape[-1]} axes; a stage has at most {_MOST_COLUMNS}: leave some out."
            )
        if name == "device_from_camera" and values.shape[-2:] != (3, 3):
            raise BadInputError(
                f"{path}: '{name}' has the shape {values.shape}; it must be 3 x 3 for each row: write the file again."
            )


def _check_plausible(path: str | Path, table: ObservationTable) -> None:
    """Refuse implausible measurements, such as lengths in millimetres."""
    if not len(table):
        raise BadInputError(f"{path}: the table is empty; write at least one reading.")
    for name in ("eye_box", "see_through_eye_box"):
        if (box := getattr(table, name)) is not None:
            require_eye_box(f"{path}: '{name}'", box.size)
            require_length(f"{path}: '{name}'", box.centre, _DEVICE_M)
    if table.panel is not None:
        size = (table.panel.width_px, table.panel.height_px)
        require_pixels(f"{path}: 'panel'", size, "correct it")
        require_on_panel(path, table.feature[table.kind == PANEL_PIXEL, :2], size)
    require_length(f"{path}: 'viewpoint', from the centre of the eye box,", table.viewpoint - table.eye_box.centre, 0.5)
    is_real = table.kind == REAL_POINT
    require_length(f"{path}: 'feature' of real points", table.feature[is_real], _WORLD_M)
    distance = np.linalg.norm(table.feature[is_real] - table.viewpoint[is_real], axis=1)
    if distance.min(initial=np.inf) < _NEAREST_M:
        raise BadInputError(
            f"{path}: 'feature' has a real point {1e3 * distance.min():.3g} mm from its viewpoint, nearer than "
            f"{1e3 * _NEAREST_M:g} mm; is it in kilometres? Convert it to metres."
        )
    conditions = table.conditions
    _check_bench(path, table)
    for name, low, high in (("capture", 0, LIMITS.index), ("target_pose", -1, LIMITS.index)):
        _require(path, name, getattr(table, name), low, high)
    _require(path, "target_pose", table.target_pose[is_real], 0, LIMITS.index)
    _require_sigma(path, table.sigma_arcmin)
    _require_places(path, table)
    _require(path, "target_point", table.target_point, -_WORLD_M, _WORLD_M)
    for name, limits in _PLAUSIBLE.items():
        _require(path, name, getattr(conditions, name), *limits)
    if not np.isin(conditions.travel[np.isfinite(conditions.travel)], (-1, 0, 1)).all():
        raise BadInputError(f"{path}: 'travel' has values other than -1, 0 and 1; write how the stage moved in x.")
    turn = conditions.device_from_camera
    turn = turn[~np.isnan(turn).all(axis=(1, 2))]
    if not np.all(np.abs(turn @ turn.mT - np.eye(3)) < 1e-6) or np.any(np.linalg.det(turn) < 0):
        raise BadInputError(f"{path}: 'device_from_camera' has matrices that are not rotations; write them again.")
    _refuse_repeated(path, table)


def _check_bench(path: str | Path, table: ObservationTable) -> None:
    """Refuse implausible motions and common errors."""
    for name in MOTIONS:
        if (motion := getattr(table, name)) is not None:
            _require(path, f"{name}_capture", motion.capture, 0, LIMITS.index)
            _require(path, f"{name}_size", motion.size, 0, 1)
            _require(path, f"{name}_log_sigma", np.array(motion.log_sigma), 0, 10)
    for name in COMMONS:
        if (common := getattr(table, name)) is not None:
            _require(path, f"{name}_capture", common.capture, 0, LIMITS.index)
            for part in ("motion", "focus"):
                _require(path, f"{name}_{part}", getattr(common, part), -1, 1)
            _require(path, f"{name}_target", common.target, -10, 10)


def _require(path: str | Path, name: str, values: NDArray[Any], low: float, high: float) -> None:
    """Refuse values outside a range; NaN means not recorded, and is allowed."""
    bad = (values < low) | (values > high)
    if bad.any():
        raise BadInputError(
            f"{path}: '{name}' has the value {values[bad].flat[0]:g}; it should be between {low:g} and {high:g}: "
            "correct it, or its unit."
        )


def _require_sigma(path: str | Path, sigma: FloatArray) -> None:
    """Refuse implausible standard deviations; zero means exact data."""
    _require(path, "sigma_arcmin", sigma, 0, _SIGMA_ARCMIN)
    if (least := sigma[sigma > 0].min(initial=np.inf)) < _LEAST_SIGMA_ARCMIN:
        raise BadInputError(
            f"{path}: 'sigma_arcmin' has the value {least:g}, less than {_LEAST_SIGMA_ARCMIN:g}; give the standard "
            "deviation in arcmin, or 0 in all rows of exact data."
        )
    if sigma.max(initial=0.0) > _SIGMAS_DIFFER * least:
        raise BadInputError(
            f"{path}: 'sigma_arcmin' is {least:g} in row {np.argmax(sigma == least)} and {sigma.max():g} in row "
            f"{np.argmax(sigma)}; it may differ by {_SIGMAS_DIFFER:g} times at most: correct the smaller one."
        )


def _require_places(path: str | Path, table: ObservationTable) -> None:
    """Refuse captures without numbers of camera positions, and an eye box much smaller than these positions."""
    count = len(np.unique(table.capture))
    if count > LIMITS.captures:
        raise BadInputError(
            f"{path}: 'capture' has {count} different numbers, more than the {LIMITS.captures} that are read; give all "
            "rows of one camera place the same number."
        )
    apart = float(np.linalg.norm(np.ptp(table.viewpoint, axis=0))) if len(table) else 0.0
    if count == 1 and apart > _ONE_PLACE_M:
        raise BadInputError(
            f"{path}: 'capture' is {table.capture[0]} in all rows, and their viewpoints are {1e3 * apart:.3g} mm "
            "apart; give each camera position a different number."
        )
    if np.linalg.norm(table.eye_box.size) < _BOX_OF_PLACES * apart:
        raise BadInputError(
            f"{path}: 'eye_box' has the size {table.eye_box.size.tolist()} m, and the viewpoints are {apart:.3g} m "
            "apart; state the eye box in metres."
        )


def require_on_panel(path: str | Path, pixel: FloatArray, size_px: ArrayLike) -> None:
    """Refuse panel pixels (n, 2) of another panel or unit: many outside the panel, or one far outside.

    Noise puts pixels decoded at the edge a little beyond it; a few decoded wrongly are left to the fit, as outliers.

    Raises:
        BadInputError: the sentence has the share outside, and a row.
    """
    size = np.asarray(size_px, dtype=np.float64)
    margin = _PANEL_MARGIN[0] + _PANEL_MARGIN[1] * size
    outside = np.any((pixel < -margin) | (pixel > size + margin), axis=1)
    far = np.any((pixel < -size) | (pixel > 2 * size), axis=1)
    if far.any() or np.sum(outside) > _MOST_OUTSIDE * len(pixel):
        row = int(np.argmax(far if far.any() else outside))
        raise BadInputError(
            f"{path}: {np.mean(outside):.1%} of the panel pixels are outside the panel of {size[0]:g} x {size[1]:g} "
            f"pixels, {np.sum(outside)} of {len(pixel)}, such as {pixel[row].tolist()}; decode in the pixels of this "
            "panel, name the device that was measured, or leave these rows out."
        )


def _refuse_repeated(path: str | Path, table: ObservationTable) -> None:
    """Refuse two rows that are equal in every column."""
    columns = [getattr(table, name) for name in COLUMNS] + [getattr(table.conditions, name) for name in _CONDITIONS]
    rows = np.column_stack([np.asarray(each, dtype=np.float64).reshape(len(table), -1) for each in columns])
    weight = np.random.default_rng(0).integers(1, 2**63, rows.shape[1], dtype=np.uint64) | np.uint64(1)
    code = np.ascontiguousarray(rows).view(np.uint64) @ weight  # equal rows have equal codes; others almost never
    order = np.argsort(code, kind="stable")
    same = code[order[1:]] == code[order[:-1]]
    same[same] = np.all(rows[order[1:][same]].view(np.uint64) == rows[order[:-1][same]].view(np.uint64), axis=1)
    if same.any():
        first, second = order[:-1][same][0], order[1:][same][0]
        raise BadInputError(f"{path}: row {second} repeats row {first} in every column; remove one.")


def _header(arrays: dict[str, NDArray[Any]], path: str | Path) -> Table:
    text = str(_array(arrays, "header", path))
    content = parse_json(path, text, "a capture file with a JSON 'header'", "write it again")
    header = Table({key: value for key, value in content.items() if value is not None}, str(path))
    header.text("format", choices=[FORMAT])
    if (version := header.number("version")) not in (1, VERSION):
        raise header.fail(f"has version {version:g}; this program reads versions 1 and {VERSION}: write it again.")
    if content.get("frame") != "openxr" or content.get("units") != _UNITS:
        raise BadInputError(f"{path}: must be in frame 'openxr' with units {_UNITS}; convert it.")
    return header
