"""Checks that refuse implausible values in a capture file, such as lengths in millimetres."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wlr_render.captures.correspondences import Captures
from wlr_render.captures.feature_captures import PANEL_PIXEL, REAL_POINT
from wlr_render.errors import BadInputError
from wlr_render.io.input_files import LIMITS, require_eye_box, require_length, require_pixels
from wlr_render.mappings import EyeBox
from wlr_render.numerics.arrays import FloatArray, IntArray

_DEVICE_M, _WORLD_M = 10.0, 100.0  # largest distance within the device, and of real points
_SIGMA_ARCMIN = 600.0  # largest sigma: ten degrees
_NEAREST_M = 0.03  # least distance of real points from the eye; a smaller one is in kilometres
_LEAST_SIGMA_ARCMIN = 1e-6  # least sigma: 0.06 milliarcseconds
_SIGMAS_DIFFER = 1e4  # largest ratio of sigmas; beyond it, a single row would decide the fit
_PANEL_MARGIN = (2.0, 0.02)  # margin outside the panel for noise: pixels, and share of the panel's side
_MOST_OUTSIDE = 0.05  # largest share of panel pixels outside the margin; a larger one is of another panel
_ONE_PLACE_M = 5e-3  # largest error of a stage that returns to a position
_BESIDE_EYE_BOX_M = 0.015  # largest distance of the mean camera position from the eye box, per axis
_BOX_OF_PLACES = 1e-2  # least size of an eye box relative to the range of camera positions
_PLAUSIBLE = {
    "capture": (0, LIMITS.index),
    "target_pose": (-1, LIMITS.index),
    "target_point": (-_WORLD_M, _WORLD_M),
    "visit": (-1, LIMITS.index),
    "channel": (-1, 2),
    "temperature_c": LIMITS.temperature_c,
    "travel": (-1, 1),
    "stage": (-10, 10),
    "time_s": (-LIMITS.time_s, LIMITS.time_s),
}
"""Range of each column; the stage is in metres or radians."""
_SMALL_PART = 0.2  # least share of the eye box that positions span; a smaller one looks like a wrong unit


def check_plausible(captures: Captures, columns: Mapping[str, NDArray[Any]], boxes: Mapping[str, EyeBox]) -> None:
    """Refuse implausible measurements, such as lengths in millimetres.

    Args:
        captures: captures of a file.
        columns: its columns by their names, in the order of its rows.
        boxes: its eye boxes by their names.

    Raises:
        BadInputError: the message names the column, a value or a row, and the remedy, but not the file.
    """
    for name, box in boxes.items():
        require_eye_box(f"'{name}'", box.size)
        require_length(f"'{name}'", box.centre, _DEVICE_M)
    if captures.panel is not None:
        size = (captures.panel.width_px, captures.panel.height_px)
        require_pixels("'panel'", size, "correct it")
        require_on_panel(columns["feature"][columns["kind"] == PANEL_PIXEL, :2], size)
    viewpoint, is_real = columns["viewpoint"], columns["kind"] == REAL_POINT
    require_length("'viewpoint', from the centre of the eye box,", viewpoint - boxes["eye_box"].centre, 0.5)
    point = columns["feature"][is_real]
    require_length("'feature' of real points", point, _WORLD_M)
    distance = np.linalg.norm(point - viewpoint[is_real], axis=1)
    if distance.min(initial=np.inf) < _NEAREST_M:
        raise BadInputError(
            f"'feature' has a real point {1e3 * distance.min():.3g} mm from its viewpoint, nearer than "
            f"{1e3 * _NEAREST_M:g} mm; is it in kilometres? Convert it to metres."
        )
    _require("target_pose", columns["target_pose"][is_real], 0, LIMITS.index)
    _require_sigma(columns["sigma_arcmin"])
    _require_places(columns["capture"], viewpoint, boxes["eye_box"].size)
    for side in captures.parts:
        if (off := far_from_eye_box(side.viewpoint, side.eye_box)) is not None:
            raise BadInputError(
                f"'viewpoint': the middle of the {side.side} positions lies {np.round(1e3 * off, 1).tolist()} mm from "
                "the centre of the eye box; give positions and eye boxes of both sides in the device frame."
            )
    for name, limits in _PLAUSIBLE.items():
        if name in columns:
            _require(name, columns[name], *limits)
    travel = columns.get("travel", np.zeros(0))
    if not np.isin(travel[np.isfinite(travel)], (-1, 0, 1)).all():
        raise BadInputError("'travel' has values other than -1, 0 and 1; write how the stage moved in x.")
    turn = columns.get("device_from_camera", np.zeros((0, 3, 3)))
    turn = turn[~np.isnan(turn).all(axis=(1, 2))]
    if not np.all(np.abs(turn @ turn.mT - np.eye(3)) < 1e-6) or np.any(np.linalg.det(turn) < 0):
        raise BadInputError("'device_from_camera' has matrices that are not rotations; write them again.")
    if "visit" in columns:
        _require_visits(columns)
    _check_bench(captures)
    _refuse_repeated(columns)


def _check_bench(captures: Captures) -> None:
    """Refuse implausible motions and common errors."""
    for side in captures.parts:
        name = side.side.replace("-", "_")
        if (motion := side.motion) is not None:
            _require(f"{name}_motion_capture", motion.capture, 0, LIMITS.index)
            _require(f"{name}_motion_size", motion.size, 0, 1)
            _require(f"{name}_motion_log_sigma", np.array(motion.log_sigma), 0, 10)
        if (common := side.common) is not None:
            _require(f"{name}_common_capture", common.capture, 0, LIMITS.index)
            for part in ("motion", "focus"):
                _require(f"{name}_common_{part}", getattr(common, part), -1, 1)
            _require(f"{name}_common_target", common.target, -10, 10)


def _require(name: str, values: NDArray[Any], low: float, high: float) -> None:
    """Refuse values outside a range; NaN means not recorded, and is allowed."""
    bad = (values < low) | (values > high)
    if bad.any():
        raise BadInputError(
            f"'{name}' has the value {values[bad].flat[0]:g}; it should be between {low:g} and {high:g}: "
            "correct it, or its unit."
        )


def _require_sigma(sigma: FloatArray) -> None:
    """Refuse implausible standard deviations; zero means exact data."""
    _require("sigma_arcmin", sigma, 0, _SIGMA_ARCMIN)
    if (least := sigma[sigma > 0].min(initial=np.inf)) < _LEAST_SIGMA_ARCMIN:
        raise BadInputError(
            f"'sigma_arcmin' has the value {least:g}, less than {_LEAST_SIGMA_ARCMIN:g}; give the standard "
            "deviation in arcmin, or 0 in all rows of exact data."
        )
    if sigma.max(initial=0.0) > _SIGMAS_DIFFER * least:
        raise BadInputError(
            f"'sigma_arcmin' is {least:g} in row {np.argmax(sigma == least)} and {sigma.max():g} in row "
            f"{np.argmax(sigma)}; it may differ by {_SIGMAS_DIFFER:g} times at most: correct the smaller one."
        )


def _require_places(capture: IntArray, viewpoint: FloatArray, box_m: FloatArray) -> None:
    """Refuse captures without numbers of camera positions, and an eye box much smaller than these positions."""
    count = len(np.unique(capture))
    if count > LIMITS.captures:
        raise BadInputError(
            f"'capture' has {count} different numbers, more than the {LIMITS.captures} that are read; give all "
            "rows of one camera place the same number."
        )
    apart = float(np.linalg.norm(np.ptp(viewpoint, axis=0)))
    if count == 1 and apart > _ONE_PLACE_M:
        raise BadInputError(
            f"'capture' is {capture[0]} in all rows, and their viewpoints are {1e3 * apart:.3g} mm "
            "apart; give each camera position a different number."
        )
    if np.linalg.norm(box_m) < _BOX_OF_PLACES * apart:
        raise BadInputError(
            f"'eye_box' has the size {box_m.tolist()} m, and the viewpoints are {apart:.3g} m "
            "apart; state the eye box in metres."
        )


def far_from_eye_box(viewpoint: FloatArray, box: EyeBox) -> FloatArray | None:
    """Return the mean (3,) of the distinct viewpoints (n, 3) from the centre of the eye box, or None if it is near.

    Positions far from the eye box are in another frame.
    """
    off = np.unique(viewpoint, axis=0).mean(axis=0) - box.centre
    return np.asarray(off) if np.any(np.abs(off) > 0.5 * box.size + _BESIDE_EYE_BOX_M) else None


def _require_visits(columns: Mapping[str, NDArray[Any]]) -> None:
    """Refuse visits at two positions, and visits that overlap in time: the camera stands still during a visit."""
    rows = np.flatnonzero(columns["visit"] >= 0)
    keys = np.stack([columns[name][rows] for name in ("kind", "target_pose", "visit")], axis=1)
    visits, first, of_row = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    of_row = of_row.reshape(-1)
    earlier, capture, viewpoint = rows[first[of_row]], columns["capture"], columns["viewpoint"]
    renumbered = capture[rows] != capture[earlier]
    moved = np.linalg.norm(viewpoint[rows] - viewpoint[earlier], axis=1) > _ONE_PLACE_M
    for bad, name in ((renumbered, "capture"), (moved, "viewpoint")):
        if bad.any():
            at = int(np.argmax(bad))
            one, other = (columns[name][row].tolist() for row in (earlier[at], rows[at]))
            raise BadInputError(
                f"{_visit_name(visits[of_row[at]])} is at two camera positions: '{name}' is {one} in row {earlier[at]} "
                f"and {other} in row {rows[at]}; give each visit its own number."
            )
    if "time_s" in columns:
        _require_times(visits, of_row, columns["time_s"][rows])


def _require_times(visits: IntArray, of_row: IntArray, time_s: FloatArray) -> None:
    """Refuse visits of one side that overlap in time; NaN means not recorded."""
    begin, end = np.full(len(visits), np.inf), np.full(len(visits), -np.inf)
    known = np.isfinite(time_s)
    np.minimum.at(begin, of_row[known], time_s[known])
    np.maximum.at(end, of_row[known], time_s[known])
    for kind in np.unique(visits[:, 0]):
        order = np.flatnonzero((visits[:, 0] == kind) & np.isfinite(begin))
        order = order[np.lexsort((end[order], begin[order]))]
        late = np.flatnonzero(begin[order[1:]] < end[order[:-1]])
        if late.size:
            before, after = order[late[0]], order[late[0] + 1]
            raise BadInputError(
                f"'time_s' goes back: {_visit_name(visits[after])} begins at {begin[after]:g} s, before "
                f"{_visit_name(visits[before])} ends at {end[before]:g} s; correct the times or the visits."
            )


def _visit_name(visit: IntArray) -> str:
    kind, pose, number = visit
    return f"'visit' {number} of " + ("the panel" if kind == PANEL_PIXEL else f"target pose {pose}")


def require_on_panel(pixel: FloatArray, size_px: ArrayLike) -> None:
    """Refuse panel pixels (n, 2) of another panel or unit: many outside the panel, or one far outside.

    Noise moves some pixels slightly beyond the edge; the fit rejects a few wrongly decoded pixels as outliers.

    Raises:
        BadInputError: the message has the share outside and one such pixel, but not the file.
    """
    size = np.asarray(size_px, dtype=np.float64)
    margin = _PANEL_MARGIN[0] + _PANEL_MARGIN[1] * size
    outside = np.any((pixel < -margin) | (pixel > size + margin), axis=1)
    far = np.any((pixel < -size) | (pixel > 2 * size), axis=1)
    if far.any() or np.sum(outside) > _MOST_OUTSIDE * len(pixel):
        row = int(np.argmax(far if far.any() else outside))
        raise BadInputError(
            f"{np.mean(outside):.1%} of the panel pixels are outside the panel of {size[0]:g} x {size[1]:g} "
            f"pixels, {np.sum(outside)} of {len(pixel)}, such as {pixel[row].tolist()}; decode in the pixels of this "
            "panel, name the device that was measured, or leave these rows out."
        )


def _refuse_repeated(columns: Mapping[str, NDArray[Any]]) -> None:
    """Refuse two rows that are equal in every column."""
    count = len(columns["kind"])
    rows = np.column_stack([np.asarray(each, np.float64).reshape(count, -1) for each in columns.values()])
    weight = np.random.default_rng(0).integers(1, 2**63, rows.shape[1], dtype=np.uint64) | np.uint64(1)
    code = np.ascontiguousarray(rows).view(np.uint64) @ weight  # equal rows have equal codes; others almost never
    order = np.argsort(code, kind="stable")
    same = code[order[1:]] == code[order[:-1]]
    same[same] = np.all(rows[order[1:][same]].view(np.uint64) == rows[order[:-1][same]].view(np.uint64), axis=1)
    if same.any():
        first, second = order[:-1][same][0], order[1:][same][0]
        raise BadInputError(f"row {second} repeats row {first} in every column; remove one.")


def place_warnings(captures: Captures) -> list[str]:
    """Warn if the camera positions span little of the eye box, as with a unit that is wrong by a factor of ten."""
    warnings = []
    for side in captures.parts:
        if len(np.unique(side.capture)) < 2:
            continue
        span, box = (1e3 * each.max() for each in (np.ptp(side.viewpoint, axis=0), side.eye_box.size))
        if span < _SMALL_PART * box:
            warnings.append(
                f"The camera places of the {side.side} captures span {span:.2g} mm of an eye box of {box:.2g} mm: are "
                "the viewpoints or the eye box in another unit than metres? The models extrapolate beyond the places."
            )
    return warnings
